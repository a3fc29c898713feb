"""From numbers to pages: the table, the figures and the report of a comparison."""
