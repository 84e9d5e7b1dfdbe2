from .problem import TIME_STEP_RANGE as TIME_STEP_RANGE
