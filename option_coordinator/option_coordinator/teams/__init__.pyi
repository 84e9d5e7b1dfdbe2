from .loading import load_room as load_room
from .team_file import Work as Work
from .team_file import room_file as room_file
