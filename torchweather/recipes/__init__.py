"""Recipes, pipelines and suites as YAML files."""
