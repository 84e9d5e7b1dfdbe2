from .grants import TASK_OVER as TASK_OVER
from .protocol_types import AgentState as AgentState
from .protocol_types import GrantStatus as GrantStatus
