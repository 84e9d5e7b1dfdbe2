import numpy as np
from ctrl_rl_core.navigation import FREE, OCCUPIED
from sim_bridge.simulation.occupancy import draw_map

from ctrl_rl_core import load_navigation_task


def test_a_map_shows_walls_and_obstacles(make_room):
    task = make_room(
        obstacles="""
  - disc: {centre: "(1.0, 0.0) m", radius: 0.25 m}
  - box: {centre: "(-1.0, 0.5) m", size: "(0.4, 0.6) m"}"""
    )
    drawn = draw_map(task, task.build_world())
    places = {(0.0, 0.0): FREE, (1.0, 0.0): OCCUPIED, (-1.0, 0.5): OCCUPIED, (2.1, 0.0): OCCUPIED}
    for place, value in places.items():
        assert drawn.at(place) == value, place
    assert drawn.resolution == 0.05
    assert drawn.at((1.9, 1.4)) == FREE


def test_walls_of_a_map_have_no_gap_and_are_no_more_than_a_cell_too_thick():
    task = load_navigation_task("curved_corridor")
    world = task.build_world()
    drawn = draw_map(task, world)
    rows, columns = np.nonzero(drawn.cells == OCCUPIED)
    assert world.signed_distance(drawn.cell_to_world(rows, columns)).max() < 0.5 * drawn.resolution
    rows, columns = np.nonzero(drawn.cells == FREE)
    assert world.signed_distance(drawn.cell_to_world(rows, columns)).min() >= 0.5 * drawn.resolution
    assert (drawn.at(world.path.pose(np.linspace(0.1, world.path.length, 100))[:, :2]) == FREE).all()
