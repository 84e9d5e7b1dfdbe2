"""Test bags and the messages written to them."""

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ctrl_rl_bags import BagWriter, Topic

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("float64 v\nfloat64 omega\n", "test_msgs/msg/Command"))
STAMP, HEADER = STORE.types["builtin_interfaces/msg/Time"], STORE.types["std_msgs/msg/Header"]
LATCHED = {
    "history": "keep_last",
    "depth": 1,
    "reliability": "reliable",
    "durability": "transient_local",
    "deadline": {"sec": 9223372036, "nsec": 854775807},
    "lifespan": {"sec": 9223372036, "nsec": 854775807},
    "liveliness": "automatic",
    "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
    "avoid_ros_namespace_conventions": False,
}
OFFICE = Path(__file__).parents[2].parent / "shared" / "data" / "tb4_office"


def topic(name, kind, qos=()):
    return Topic(name, kind, STORE.generate_msgdef(kind, ros_version=2)[0], STORE.hash_rihs01(kind), qos)


def cdr(message):
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def text(value):
    return cdr(STORE.types["std_msgs/msg/String"](value))


def header(nanoseconds):
    return HEADER(STAMP(nanoseconds // 10**9, nanoseconds % 10**9), "odom")


def twist(v, omega):
    vector, kind = STORE.types["geometry_msgs/msg/Vector3"], STORE.types["geometry_msgs/msg/Twist"]
    return kind(vector(v, 0.0, 0.0), vector(0.0, 0.0, omega))


def odometry(stamp, x, y, yaw, v=0.0, omega=0.0):
    types = STORE.types
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](x, y, 0.0),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)),
    )
    return types["nav_msgs/msg/Odometry"](
        header(stamp),
        "base_footprint",
        types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        types["geometry_msgs/msg/TwistWithCovariance"](twist(v, omega), np.zeros(36)),
    )


def scan(stamp, ranges):
    ranges = np.asarray(ranges, dtype=np.float32)
    return STORE.types["sensor_msgs/msg/LaserScan"](
        header(stamp), 0.0, 0.01745 * (len(ranges) - 1), 0.01745, 0.0, 0.2, 0.12, 3.5, ranges, np.empty(0, np.float32)
    )


def write_texts(folder, count=40, step=10_000_000, **options):
    with BagWriter(folder, **options) as bag:
        bag.add_topic(topic("/talk", "std_msgs/msg/String", (LATCHED,)))
        bag.set_custom_data("digest.task", "0123")
        for i in range(count):
            bag.write("/talk", text(f"{i} " + "x" * (i % 7)), i * step, i * step + 5, i)
    return folder
