"""One self-contained HTML page that shows results: text, tables, pictures and animated bird's-eye rollouts."""
