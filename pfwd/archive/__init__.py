"""Inverts whole archives: folders of surveys and trace files, on local cores or on a cluster.

What comes of it is kept in a folder of Parquet tables that can be continued at any time.
"""
