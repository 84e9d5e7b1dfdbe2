from .expert import Expert as Expert
from .run import TaughtRun as TaughtRun
from .student import Student as Student
