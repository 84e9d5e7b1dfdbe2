from .plots import draw_ladder as draw_ladder
from .plots import draw_pages as draw_pages
from .results import LadderFigures as LadderFigures
from .task_list import LADDER as LADDER
from .task_list import load_ladder_task as load_ladder_task
