"""Reports: one self-contained page of findings, tables and pictures, made from tidy rows."""
