"""Workers that compute the chunks of a sweep: this process, or any executor.

The bits of a chunk do not depend on the worker. This process stores each finished chunk ([vibrojax.io.shards][]).
"""
