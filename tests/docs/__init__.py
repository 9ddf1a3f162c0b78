"""The documents against the code: links, names, code blocks, tables of scores."""
