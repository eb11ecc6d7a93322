"""A team of one process an agent: its agents, who starts them and who watches them."""
