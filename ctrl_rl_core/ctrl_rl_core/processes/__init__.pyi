from .children import end_with_ros2 as end_with_ros2
from .children import start_child as start_child
from .limited import limited_memory as limited_memory
from .ray_workers import Tell as Tell
from .ray_workers import map_in_ray as map_in_ray
from .ray_workers import require_ray as require_ray
from .signals import handle_signals as handle_signals
from .signals import interrupt_once as interrupt_once
