from .track_table import TrackTableWriter, read_tracks_table

__all__ = ["TrackTableWriter", "read_tracks_table"]
