from .observation import ObservationBuilder as ObservationBuilder
from .policy import policy_digest as policy_digest
from .policy import shipped_policies as shipped_policies
from .task_interface import state_ranges as state_ranges
