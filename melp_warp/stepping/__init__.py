"""From step to step: the order of the stages, how a state begins, changes its regions, bursts and is stored."""
