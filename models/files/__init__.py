"""Files and the bounds on what they hold: arrays, text, and writing that is whole or not at all."""
