"""Text and plots made of characters; no widget, no application."""
