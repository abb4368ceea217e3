"""Sockets for datagrams, by which a plant and a firmware talk."""

import socket

from maidenflight.errors import InputError


def listening(address: tuple[str, int], refused: str, advice: str) -> socket.socket:
    """Returns a socket that listens at an address.

    Args:
        address: host and port.
        refused: what it means where the address cannot be had.
        advice: what to do then.

    Raises:
        InputError: the address cannot be had.
    """
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        line.bind(address)
    except OSError as error:
        line.close()
        raise InputError(f"plant: {refused} ({error.strerror}). {advice}") from error
    return line
