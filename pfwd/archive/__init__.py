"""Inversion of archives: folders of surveys and trace files, on local cores or on a cluster.

The results are stored in a folder of Parquet tables that can be continued at any time.
"""
