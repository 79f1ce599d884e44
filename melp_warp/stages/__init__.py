"""The stages of a step, a module each, with what they share: the state, the film and its neighbour lists."""
