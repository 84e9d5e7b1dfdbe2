"""Occupancy maps: files of map_server's three modes, messages, geometry, and invalid input."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from PIL import Image

from ctrl_rl_core import MapError, OccupancyMap, signed_distance

HEADER = {"image": "map.png", "resolution": 0.1, "origin": [1.0, 2.0, 0.0]}


@pytest.fixture
def write(tmp_path: Path):
    def run(pixels: np.ndarray, **changes: object) -> Path:
        Image.fromarray(pixels).save(tmp_path / "map.png")
        path = tmp_path / "map.yaml"
        path.write_text("".join(f"{key}: {value}\n" for key, value in {**HEADER, **changes}.items()))
        return path

    return run


@pytest.fixture
def room() -> OccupancyMap:
    cells = np.zeros((6, 8), np.int8)
    cells[0], cells[-1], cells[:, 0], cells[3, 4:6], cells[4, 7] = 100, 100, 100, 100, -1
    return OccupancyMap(cells, 0.5, (1.0, -2.0, 0.4))


def test_modes_read_shades_as_map_server_does(write) -> None:
    grey = np.array([[0, 50, 100], [150, 254, 255]], np.uint8)
    trinary = OccupancyMap.load(write(grey))
    assert trinary.cells.tolist() == [[-1, 0, 0], [100, 100, -1]]  # 150: 0.41 occupied; the lower row first
    assert trinary.resolution == 0.1
    assert trinary.origin == (1.0, 2.0, 0.0)
    assert OccupancyMap.load(write(grey, negate=1)).cells.tolist() == [[-1, 100, 100], [0, 0, -1]]
    assert OccupancyMap.load(write(grey, mode="scale")).cells.tolist() == [[-1, 0, 0], [100, 100, 100]]
    assert OccupancyMap.load(write(grey, mode="raw")).cells.tolist() == [[-1, -1, -1], [0, -1, 100]]
    wide = OccupancyMap.load(write(grey.astype(np.uint16) * 257))
    assert wide.cells.tolist() == trinary.cells.tolist()


def test_transparent_pixels_are_unknown_in_scale_mode_and_darker_colours_more_occupied(write) -> None:
    pixels = np.array([[[255, 255, 255, 255], [255, 255, 255, 0], [0, 0, 0, 255]]], np.uint8)
    assert OccupancyMap.load(write(pixels, mode="scale")).cells.tolist() == [[0, -1, 100]]
    assert OccupancyMap.load(write(pixels)).cells.tolist() == [[0, -1, 100]]  # opacity is a fourth colour
    assert OccupancyMap.load(write(pixels[..., :3])).cells.tolist() == [[0, 0, 100]]


def test_the_grey_of_map_saver_is_unknown_whatever_threshold_it_wrote(write) -> None:
    saved = np.array([[0, 205, 254]], np.uint8)
    for threshold in (0.25, 0.196):
        assert OccupancyMap.load(write(saved, free_thresh=threshold)).cells.tolist() == [[100, -1, 0]]
    assert OccupancyMap.load(write(np.array([[0, 205, 206]], np.uint8))).cells.tolist() == [[100, 0, 0]]


def test_file_and_message_give_the_same_map_back(room: OccupancyMap, tmp_path: Path) -> None:
    room.save(tmp_path / "room.yaml")
    message = room.to_message(Time(sec=3), "map")
    assert (message.info.width, message.info.height, message.header.stamp.sec) == (8, 6, 3)
    for again in (OccupancyMap.load(tmp_path / "room.yaml"), OccupancyMap.from_message(message)):
        assert np.array_equal(again.cells, room.cells)
        assert again.resolution == room.resolution
        assert again.origin == pytest.approx(room.origin)
    message.info.width = 7
    with pytest.raises(MapError, match="6 x 7 cells with 48 values"):
        OccupancyMap.from_message(message)
    message.info.origin.orientation.w = 0.0
    with pytest.raises(MapError, match="quaternion"):
        OccupancyMap.from_message(message)


def test_cells_and_points_agree_under_a_turned_origin(room: OccupancyMap) -> None:
    rows, columns = np.indices(room.cells.shape)
    points = room.cell_to_world(rows, columns)
    assert np.array_equal(np.stack(room.world_to_cell(points)), (rows, columns))
    assert np.array_equal(room.at(points), room.cells)
    assert room.to_grid(points) == pytest.approx(np.stack((rows, columns), axis=-1), abs=1e-9)
    assert room.at([[1e30, 0.0], [-50.0, 3.0]]).tolist() == [-1, -1]
    assert room.cell_to_world(0, 0) == pytest.approx(
        [1 + 0.25 * (np.cos(0.4) - np.sin(0.4)), -2 + 0.25 * (np.sin(0.4) + np.cos(0.4))]
    )


def test_boxes_cover_the_occupied_cells_and_nothing_else(room: OccupancyMap) -> None:
    boxes = room.boxes()
    inside = np.sum(
        [box.signed_distance(room.cell_to_world(*np.indices(room.cells.shape))) < 0.0 for box in boxes], axis=0
    )
    assert np.array_equal(inside, room.cells == 100)
    assert len(boxes) == 4
    assert OccupancyMap(np.zeros((2, 2), np.int8), 1.0).boxes() == ()


def test_clearance_is_the_distance_to_the_nearest_box(room: OccupancyMap) -> None:
    points = room.cell_to_world(*np.indices(room.cells.shape))
    truth = np.maximum(signed_distance(room.boxes(), points), 0.0)
    assert room.clearance(unknown_is_free=True) == pytest.approx(truth, abs=0.21 * room.resolution)
    known = room.clearance()
    assert known[2, 7] == pytest.approx(0.25)  # the edge of the map
    assert known[4, 7] == 0.0
    assert np.isinf(OccupancyMap(np.zeros((2, 2), np.int8), 1.0).clearance(unknown_is_free=True)).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"resolution": 0.0}, "resolution"),
        ({"resolution": ".nan"}, "resolution"),
        ({"resolution": 100.0}, "resolution 100.0: must be 0.001 to 10 m"),
        ({"origin": "[0, 0]"}, "origin"),
        ({"origin": "[0, 0, .inf]"}, "origin"),
        ({"mode": "grey"}, "mode"),
        ({"negate": 2}, "negate"),
        ({"free_thresh": 0.7}, "free_thresh 0.7 must be less"),
        ({"image": "none.png"}, "none.png: there is no such file"),
        ({"image": "map.yaml"}, "is not a readable image"),
        ({"image": "."}, "is a folder"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line_that_names_it(write, changes: dict, words: str) -> None:
    path = write(np.zeros((2, 2), np.uint8), **changes)
    with pytest.raises(MapError) as caught:
        OccupancyMap.load(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path.parent))
    assert "\n" not in str(caught.value)


def test_a_cut_image_and_a_map_without_cells_are_refused(write, tmp_path: Path) -> None:
    path = write(np.zeros((50, 50), np.uint8))
    image = tmp_path / "map.png"
    image.write_bytes(image.read_bytes()[:40])
    with pytest.raises(MapError, match="is a damaged PNG"):
        OccupancyMap.load(path)
    for cells in (np.zeros((0, 3), np.int8), np.zeros(3, np.int8)):
        with pytest.raises(MapError, match="cells"):
            OccupancyMap(cells, 0.1)
    with pytest.raises(MapError, match="occupancies"):
        OccupancyMap.from_percent(np.array([[101]], np.int8), 0.1, (0.0, 0.0, 0.0))


def test_the_map_of_a_real_office(real_drive: Path) -> None:
    office = OccupancyMap.load(real_drive / "mac_1st_floor_final.yaml")
    assert office.size == pytest.approx((27.09, 51.18))
    counts = {value: int(np.count_nonzero(office.cells == value)) for value in (0, 100, -1)}
    assert counts == {0: 303533, 100: 16871, -1: 1220114}


def png_map(folder: Path, image: Image.Image) -> Path:
    image.save(folder / "room.png")
    (folder / "room.yaml").write_text("{image: room.png, resolution: 0.1, origin: [0, 0, 0]}")
    return folder / "room.yaml"


@pytest.mark.fault
def test_no_single_flip_of_a_png_gives_another_map(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    shades = random.choice(np.array([0, 205, 254], np.uint8), size=(20, 30))
    path = png_map(tmp_path, Image.fromarray(shades))
    image, whole = tmp_path / "room.png", (tmp_path / "room.png").read_bytes()
    right = OccupancyMap.load(path)
    for at in range(len(whole)):
        image.write_bytes(whole[:at] + bytes((whole[at] ^ 1 << int(random.integers(8)),)) + whole[at + 1 :])
        with suppress(MapError):
            assert OccupancyMap.load(path).is_same(right)
    image.write_bytes(whole[:-20])
    with pytest.raises(MapError, match="damaged PNG"):
        OccupancyMap.load(path)


def test_an_opaque_alpha_channel_changes_nothing(tmp_path: Path) -> None:
    shades = np.array([[0, 205, 254]], np.uint8)
    plain = OccupancyMap.load(png_map(tmp_path, Image.fromarray(shades)))
    opaque = Image.fromarray(np.dstack([shades] * 3 + [np.full_like(shades, 255)]))
    assert OccupancyMap.load(png_map(tmp_path, opaque)).is_same(plain)


def test_a_map_with_another_resolution_is_another_map() -> None:
    cells = np.zeros((3, 4), np.int8)
    assert OccupancyMap(cells, 0.1).is_same(OccupancyMap(cells, 0.1))
    assert not OccupancyMap(cells, 0.1).is_same(OccupancyMap(cells, 0.05))
    assert not OccupancyMap(cells, 0.1).is_same(OccupancyMap(cells, 0.1, (1.0, 0.0, 0.0)))


@pytest.mark.parametrize("largest", [100, 255, 1000, 65535])
@pytest.mark.parametrize("plain", [True, False])
def test_the_range_and_encoding_of_a_pgm_change_nothing(tmp_path: Path, largest: int, plain: bool) -> None:
    """Pillow read a range of 1000 value by value: 33 s for 4,000 x 4,000 cells."""
    shades = np.array([[0.0, 1.0, 0.8], [0.5, 0.9, 0.1]])
    numbers = np.rint(largest * shades).astype(">u2" if largest > 255 else "u1")
    pixels = b"# words\n" + b" ".join(b"%d" % each for each in numbers.ravel()) if plain else numbers.tobytes()
    image = tmp_path / "map.pgm"
    image.write_bytes(b"%s\n3 2\n%d\n" % (b"P2" if plain else b"P5", largest) + pixels)
    file = tmp_path / "map.yaml"
    file.write_text(
        "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\nmode: scale\n"
        "occupied_thresh: 0.9\nfree_thresh: 0.2\n"
    )
    found = OccupancyMap.load(file)
    assert found.cells[::-1].tolist() == [[100, 0, 0], [-1, 0, 100]]
    image.write_bytes(image.read_bytes()[:-6])
    with pytest.raises(MapError, match=str(image)):
        OccupancyMap.load(file)
