from .messages import EXCHANGE as EXCHANGE
