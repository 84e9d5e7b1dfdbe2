from .protocol_types import GrantStatus as GrantStatus
