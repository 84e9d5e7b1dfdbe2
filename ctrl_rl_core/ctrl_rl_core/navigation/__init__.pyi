from .occupancy_map import FREE as FREE
from .occupancy_map import OCCUPIED as OCCUPIED
from .transform_conflicts import TransformConflicts as TransformConflicts
