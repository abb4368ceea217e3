"""The verbs: a class each, with its settings, what it computes and what it prints."""
