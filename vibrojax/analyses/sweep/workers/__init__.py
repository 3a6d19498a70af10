"""Who computes the chunks of a sweep: this process, any executor, or processes that share a folder.

A chunk's bits are the same whoever computes it; what is finished lies in shards ([vibrojax.io.shards][]), and
nothing else is believed.
"""
