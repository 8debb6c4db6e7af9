"""Lab tests in virtual time: a pytest session hands some of its tests to sessions inside boxes and reports as its own.

    pytest on the host (outside.py)                            pytest in a box (inside.py)
      chooses the tests (selection.py)                           collects them again, by the same arguments
      opens boxes when the first of them is due (boxes.py)       runs them, unaware
      reports each as if it had run here  <--- records.py ---    writes down every report as it comes

The folder that both share is the box's output folder: ``wanted.json`` in, ``records`` and ``captures/`` out.
``pytest_plugin.py`` registers one of the two sides.
"""
