"""The Playground: a page in the browser to watch, steer and replay a mission."""
