"""Benchmarks of the project: ``pfwd bench [PART]`` from a checkout.

A part is a module with ``run(arguments) -> exit status``; with ``--json`` it prints one JSON object
per line.  Speeds are reported as ratios within one run, because machines differ.
"""
