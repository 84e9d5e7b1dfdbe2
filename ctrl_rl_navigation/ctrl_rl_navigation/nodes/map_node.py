"""Map server: publishes a map file on a latched topic, if no other map server is running."""

from __future__ import annotations

import sys
from typing import ClassVar

from ctrl_rl_core.ros import LATCHED, Status, ok
from nav_msgs.msg import OccupancyGrid

from ctrl_rl_core import OccupancyMap, Parameter, ParameterError, SuiteNode, run_node
from ctrl_rl_navigation.maps import load_map


class MapServer(SuiteNode):
    """Publishes a map file on `map`, latched; the file can be changed at run time."""

    PARAMETERS: ClassVar[tuple[Parameter, ...]] = (
        Parameter("map", "", "Name of a map of the suite, or a .yaml file of map_server.", live=True, kind="path"),
        Parameter("frame", "map", "Frame of the map.", kind="name"),
        Parameter("topic", "map", "Topic of the map.", kind="name"),
    )

    def __init__(self) -> None:
        super().__init__("map_server")
        self._publisher = self.create_publisher(OccupancyGrid, self.settings["topic"], LATCHED)
        self._publish()

    def on_parameter_changed(self, name: str) -> None:
        """Publish another map."""
        if name == "map":
            self._publish()

    def status(self) -> Status:
        """Report the published map."""
        return ok("serving", map=self.settings["map"], size=self._size)

    def _publish(self) -> None:
        name = self.settings["map"]
        if not name:
            raise ParameterError("parameter 'map' is empty: give the .yaml file of a map")
        map_: OccupancyMap = load_map(name)
        self._size = f"{map_.size[0]:.1f} x {map_.size[1]:.1f} m"
        self._publisher.publish(map_.to_message(self.get_clock().now().to_msg(), self.settings["frame"]))
        self.get_logger().info(f"{name}: {self._size} at {map_.resolution:g} m")


def main() -> int:
    """Entry point of `ros2 run ctrl_rl_navigation map_server`."""
    return run_node(MapServer)


if __name__ == "__main__":
    sys.exit(main())
