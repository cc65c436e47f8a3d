"""Subgrade modulus from falling-weight records: forward model, search, uncertainty."""
