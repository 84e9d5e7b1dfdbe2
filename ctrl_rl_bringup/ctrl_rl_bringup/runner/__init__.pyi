from .domain import own_domain as own_domain
from .stack import NodeSpec as NodeSpec
from .stack import policy_nodes as policy_nodes
from .stack import simulator as simulator
from .transport import answer_latencies as answer_latencies
from .transport import lost_messages as lost_messages
from .transport import read_sent as read_sent
