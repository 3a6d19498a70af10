"""Workers that compute the chunks of a sweep: this process, any executor, or processes that share a folder.

The bits of a chunk do not depend on the worker. Finished chunks are files ([vibrojax.io.shards][]); only the files
determine which chunks are finished.
"""
