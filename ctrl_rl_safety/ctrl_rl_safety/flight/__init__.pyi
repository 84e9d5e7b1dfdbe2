from .escapes import best_escape as best_escape
from .escapes import nearest_safe as nearest_safe
from .escapes import record as record
