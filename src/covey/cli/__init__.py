"""The command line, one module a command; heavy libraries are imported when a command runs, so that help is instant."""
