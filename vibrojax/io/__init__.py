"""Datasets on disk, the finished chunks of a sweep, and the claims of the processes that write them.

This file imports nothing, so that the version of the package is available at once.
"""
