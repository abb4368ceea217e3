"""Files of JSON with one thing wrong."""

import json


def damaged(content, *path, to):
    """The text of the content with one entry replaced, or removed where `to` is ``...``."""
    content = json.loads(json.dumps(content))
    place = content
    for step in path[:-1]:
        place = place[step]
    if to is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = to
    return json.dumps(content)
