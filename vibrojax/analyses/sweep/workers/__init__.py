"""Workers that compute the chunks of a sweep: this process, any executor, or processes that share a folder.

The bits of a chunk do not depend on who computes it. Finished chunks are files ([vibrojax.io.shards][]), which alone
decide what is finished.
"""
