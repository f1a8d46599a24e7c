"""Tests of the pages and figures of tunings."""
