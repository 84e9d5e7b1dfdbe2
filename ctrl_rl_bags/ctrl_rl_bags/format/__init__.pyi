from .checks import fields_of as fields_of
