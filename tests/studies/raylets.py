"""A Ray cluster of raylets on this machine, each a process like a machine's own, one core each.

Prints its address. A line on standard input kills a raylet with all its tasks and adds another; the
end of the input ends the cluster.
"""

import sys
from importlib import import_module

if __name__ == "__main__":
    cluster = import_module("ray.cluster_utils").Cluster(
        initialize_head=True,
        head_node_args={
            "num_cpus": 0,
            "object_store_memory": 80_000_000,
            "include_dashboard": False,
        },
    )
    nodes = [cluster.add_node(num_cpus=1, object_store_memory=80_000_000) for _ in range(3)]
    print(cluster.address, flush=True)
    for _ in sys.stdin:
        cluster.remove_node(nodes.pop(0), allow_graceful=False)
        nodes.append(cluster.add_node(num_cpus=1, object_store_memory=80_000_000))
        print("killed", flush=True)
    cluster.shutdown()
