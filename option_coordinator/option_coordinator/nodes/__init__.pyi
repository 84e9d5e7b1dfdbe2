from .messages import EXCHANGE as EXCHANGE
from .messages import request_message as request_message
from .messages import status_message as status_message
