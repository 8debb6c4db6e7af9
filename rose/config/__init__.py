"""Configuration of hosts: the same words in YAML and in XML, checked with file and line."""
