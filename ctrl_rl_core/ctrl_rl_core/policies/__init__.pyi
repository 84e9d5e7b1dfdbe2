from .actor_policy import policy_of as policy_of
from .manifest import ScanPart as ScanPart
from .observation import ObservationBuilder as ObservationBuilder
from .policy import policy_digest as policy_digest
from .policy import shipped_policies as shipped_policies
from .pose_input import POSE_PARAMETERS as POSE_PARAMETERS
from .pose_input import PoseInput as PoseInput
from .task_interface import state_ranges as state_ranges
