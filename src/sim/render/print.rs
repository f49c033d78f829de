//! The cells of a printed marker.

/// Ten by ten cells, true = white, row 0 at the top: the 8 x 8 of tag36h11 with its black border, and the white ring.
pub type Cells = [[bool; 10]; 10];

/// The cells of tag36h11 number `id`; `None` when the family has no such number.
pub fn marker_cells(id: u32) -> Option<Cells> {
    (id < 587).then(|| {
        let mut cells = [[true; 10]; 10];
        for (r, row) in cells.iter_mut().enumerate() {
            for (c, cell) in row.iter_mut().enumerate() {
                if (1..9).contains(&r) && (1..9).contains(&c) {
                    *cell =
                        (2..8).contains(&r) && (2..8).contains(&c) && (id as usize >> ((r * c) % 9)) & 1 == 1;
                }
            }
        }
        cells
    })
}
