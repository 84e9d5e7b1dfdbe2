from .simulation import task_content as task_content
