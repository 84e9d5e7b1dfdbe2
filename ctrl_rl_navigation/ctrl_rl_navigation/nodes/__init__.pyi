from .navigator_node import NavigatorNode as NavigatorNode
