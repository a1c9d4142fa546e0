from .watch import (
    Event,
    EventWriter,
    Kind,
    Line,
    Moment,
    Sighting,
    Watch,
    Zone,
    Zones,
    read_events,
    read_zones,
)

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
