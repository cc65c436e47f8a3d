"""The project's benchmarks: ``pfwd bench [PART]`` from a checkout.

A part is a module with ``run(arguments) -> exit status``; with ``--json`` it prints one object a
line.  Speed is reported as ratios within one run, because machines differ.
"""
