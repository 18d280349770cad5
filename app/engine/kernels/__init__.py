"""Numba kernels: arrays in, arrays out, no checks, nothing allocated but the output and scratch.

Each has an obviously right slow twin in ``tests/reference``.
"""
