from .message_types import UnknownTypeError as UnknownTypeError
from .message_types import message_class as message_class
from .message_types import register as register
from .message_types import typestore as typestore
from .qos import publisher_qos as publisher_qos
from .recorder_node import RecorderNode as RecorderNode
