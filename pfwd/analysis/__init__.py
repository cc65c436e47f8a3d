"""From drops to results: judged, inverted here or in a process of their own, plotted."""
