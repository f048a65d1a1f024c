"""The hidden-stems experiment: motions planned with what cameras see of a plant, judged by the whole plant."""
