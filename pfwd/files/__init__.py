"""Files: trace files and their headers, surveys as points, what is said of them afterwards."""
