"""A page of a run folder in the browser: forms derived from verbs, which run as commands there."""
