//! Rectangles painted one over the other, wrapping around the edges of the canvas.

/// A rectangle of one tone, in samples.
#[derive(Clone, Copy, Debug)]
pub struct Rectangle {
    /// First row.
    pub top: usize,
    /// First column.
    pub left: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// What it is painted with.
    pub tone: f64,
}

/// The canvas of `rows` by `columns` samples of a level, row by row, with the rectangles.
pub fn paint(rows: usize, columns: usize, level: f64, rectangles: impl Iterator<Item = Rectangle>) -> Vec<f64> {
    let mut canvas = vec![level; rows * columns];
    if canvas.is_empty() {
        return canvas;
    }
    for Rectangle { top, left, height, width, tone } in rectangles {
        let (left, width) = (left % columns, width.min(columns));
        let end = (left + width).min(columns);
        for r in 0..height.min(rows) {
            let line = &mut canvas[(top % rows + r) % rows * columns..][..columns];
            line[left..end].fill(tone);
            line[..left + width - end].fill(tone);
        }
    }
    canvas
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_wrap_around_the_edges_and_later_ones_cover_earlier_ones() {
        let rectangle = |top, left, height, width, tone| Rectangle { top, left, height, width, tone };
        let canvas = paint(3, 4, 0.0, [rectangle(2, 3, 2, 2, 1.0), rectangle(0, 0, 1, 9, 2.0)].into_iter());
        assert_eq!(canvas, [2.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    }
}
