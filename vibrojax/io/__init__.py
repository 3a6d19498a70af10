"""What is on disk: datasets, the finished chunks of a sweep, and who may write them.

Nothing is imported here, so that the version, which needs none of it, is there at once.
"""
