from .checks import fields_of as fields_of
from .type_definitions import BagTypes as BagTypes
