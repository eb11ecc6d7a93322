"""What a run tells while it goes on, and what may be asked of it."""
