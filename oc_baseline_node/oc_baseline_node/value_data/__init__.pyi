from .dataset import open_folder as open_folder
from .dataset import write_chunk as write_chunk
