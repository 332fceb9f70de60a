"""Our environments in the classes of other libraries, one library a module."""
