from .table import play_episode as play_episode
