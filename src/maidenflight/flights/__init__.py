"""Flight logs: reading, checking, cutting into windows, and recording on a virtual drone."""
