from .occupancy_map import FREE as FREE
from .occupancy_map import OCCUPIED as OCCUPIED
from .pose_source import POSE_SOURCES as POSE_SOURCES
from .pose_source import OdometryTrack as OdometryTrack
from .transform_conflicts import TransformConflicts as TransformConflicts
from .transform_tree import Transform as Transform
from .transform_tree import TransformError as TransformError
from .transform_tree import TransformTree as TransformTree
