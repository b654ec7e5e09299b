"""What a capture lacks, made from what it has: colours of vertices, a far shell behind the mesh."""
