"""Storage: datasets on disk, finished chunks of a sweep, and claims of the processes that write chunks.

This file imports nothing, so that reading the package version is fast.
"""
