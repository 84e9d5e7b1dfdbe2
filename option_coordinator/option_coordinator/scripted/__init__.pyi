from .policy_queries import SCRIPTED as SCRIPTED
