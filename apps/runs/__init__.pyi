from .loop import (
    Application,
    Columns,
    Engine,
    FilmJob,
    Filter,
    Line,
    Output,
    Page,
    Plot,
    Sink,
    Start,
    run_film,
)
from .row_log import RowLog

__all__ = [
    "Application",
    "Columns",
    "Engine",
    "FilmJob",
    "Filter",
    "Line",
    "Output",
    "Page",
    "Plot",
    "RowLog",
    "Sink",
    "Start",
    "run_film",
]
