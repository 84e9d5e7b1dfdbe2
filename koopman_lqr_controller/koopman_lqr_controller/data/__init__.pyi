from .trajectory_segments import mean_time_step as mean_time_step
