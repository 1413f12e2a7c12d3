"""The generated Structured Text, parsed, translated to C, and run against real shared memory."""
