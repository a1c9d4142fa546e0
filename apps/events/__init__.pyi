from .watch import Event, EventWriter, Kind, Moment, Sighting, Watch, read_events
from .zones import Line, Zone, Zones, read_zones

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
