from .protocol_types import AgentState as AgentState
from .protocol_types import GrantStatus as GrantStatus
