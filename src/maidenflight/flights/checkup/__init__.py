"""The check-up of a log: named tests of its conventions against physics."""
