"""Which of the sensor's rows a place of the picture lies in, whichever way the picture was turned to be shown."""


def row_of(x_px: float, y_px: float, shape: tuple[int, int], quarter_turns: int) -> tuple[float, int]:
    """The sensor's row of a place in a picture of `shape` (rows, columns), counted as it is read out, and their number.

    quarter_turns: by which the sensor's picture was turned counterclockwise.
    """
    rows, columns = shape
    match quarter_turns % 4:
        case 1:
            return x_px, columns
        case 2:
            return rows - 1 - y_px, rows
        case 3:
            return columns - 1 - x_px, columns
    return y_px, rows


def rows_share(width: int, height: int, shape: tuple[int, int], quarter_turns: int) -> float:
    """The share of the sensor's rows that a region of this size takes up in a picture of `shape` (rows, columns)."""
    along, whole = (width, shape[1]) if quarter_turns % 2 else (height, shape[0])
    return along / max(whole, 1)
