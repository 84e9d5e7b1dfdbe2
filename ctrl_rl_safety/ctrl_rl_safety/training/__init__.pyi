from .safety_shield import SafetyShield as SafetyShield
from .shield import Shield as Shield
from .shield import ShieldOptions as ShieldOptions
from .shield import shielded_environment as shielded_environment
from .told_actions import ToldActions as ToldActions
from .told_actions import ToldPPO as ToldPPO
