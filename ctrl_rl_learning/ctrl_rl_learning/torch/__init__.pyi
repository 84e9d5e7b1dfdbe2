from .array_file import load_arrays as load_arrays
from .array_file import save_arrays as save_arrays
from .learner_state import Arrays as Arrays
from .learner_state import restore_state as restore_state
from .learner_state import state_arrays as state_arrays
from .optimization import gradient_step as gradient_step
from .optimization import polyak_update as polyak_update
from .replay_buffer import ReplayBuffer as ReplayBuffer
