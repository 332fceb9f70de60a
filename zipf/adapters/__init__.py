"""Our environments in the classes of other libraries, and their agents as policies that
`zipf.evaluate.score` takes; one library a module."""
