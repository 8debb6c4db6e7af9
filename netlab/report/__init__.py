"""``netlab report``: one HTML page of plots from a capture. Data (pure), drawing (matplotlib) and page are apart."""
