from .fast_marching import march as march
