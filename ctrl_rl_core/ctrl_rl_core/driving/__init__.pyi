from .arrival import ENDED as ENDED
from .watchdog_node import INPUT as INPUT
