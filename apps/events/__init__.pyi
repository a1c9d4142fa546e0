from .event_files import EventWriter, read_events
from .watch import Event, Kind, Moment, Sighting, Watch
from .zone_files import read_zones
from .zones import Line, Zone, Zones

__all__ = [
    "Event",
    "EventWriter",
    "Kind",
    "Line",
    "Moment",
    "Sighting",
    "Watch",
    "Zone",
    "Zones",
    "read_events",
    "read_zones",
]
