"""The contracts: pydantic models of every document, Arrow schemas of every table, and the error tree."""
