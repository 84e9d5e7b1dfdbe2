from .controller_node import Controller as Controller
