//! A part of a frame that is kept for the next one, in the frame's own type of pixel.

use super::image::{Image, Pixel, Region};
use serde::{Deserialize, Serialize};

/// A type of pixel that can be kept.
pub trait Storable: Pixel {
    /// Its pixels in a store; emptied, or made new where the store held another type.
    fn emptied(store: &mut Store) -> &mut Vec<Self>;
    /// Its pixels; None where the store holds another type.
    fn held(store: &Store) -> Option<&[Self]>;
}

macro_rules! store {
    ($($name:ident $kind:ty,)*) => {
        /// Pixels of one type.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub enum Store {
            $(#[allow(missing_docs)] $name(Vec<$kind>),)*
        }

        $(impl Storable for $kind {
            fn emptied(store: &mut Store) -> &mut Vec<Self> {
                if !matches!(store, Store::$name(_)) {
                    *store = Store::$name(Vec::new());
                }
                match store {
                    Store::$name(pixels) => {
                        pixels.clear();
                        pixels
                    }
                    // It has just been made one of these.
                    _ => unreachable!(),
                }
            }

            fn held(store: &Store) -> Option<&[Self]> {
                if let Store::$name(pixels) = store { Some(pixels) } else { None }
            }
        })*
    };
}
store! { U8 u8, U16 u16, I16 i16, I32 i32, I64 i64, F32 f32, F64 f64, }

/// The pixels of a region, row after row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    store: Store,
    rows: usize,
    columns: usize,
    /// First column and row in the frame.
    pub corner: [i64; 2],
}

impl Kept {
    /// Takes the place of `kept`, whose memory is used again: a part of a frame, that begins at a region's corner.
    pub fn replace<T: Storable>(kept: &mut Option<Self>, part: &Image<'_, T>, region: Region) {
        let Region { x, y, .. } = region;
        let kept = kept.get_or_insert(Self { store: Store::U8(Vec::new()), rows: 0, columns: 0, corner: [0; 2] });
        (kept.rows, kept.columns, kept.corner) = (part.rows, part.columns, [x, y]);
        let pixels = T::emptied(&mut kept.store);
        for r in 0..part.rows {
            pixels.extend_from_slice(part.row(r));
        }
    }

    /// The pixels; None where they are of another type.
    pub fn image<T: Storable>(&self) -> Option<Image<'_, T>> {
        Image::new(T::held(&self.store)?, self.rows, self.columns, self.columns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_kept_in_its_own_type_and_another_one_takes_its_place() {
        let pixels: Vec<u16> = (0..60).collect();
        let region = Region { x: 2, y: 1, width: 3, height: 2 };
        let part = Image::new(&pixels, 6, 10, 10).unwrap().cut(region).unwrap();
        let mut kept = None;
        Kept::replace(&mut kept, &part, region);
        let one = kept.clone().unwrap();
        assert_eq!((one.image::<u16>().unwrap().row(1), one.corner), (&[22, 23, 24][..], [2, 1]));
        assert!(one.image::<u8>().is_none());
        Kept::replace(&mut kept, &Image::new(&[1.5f32, 2.5], 1, 2, 2).unwrap(), region);
        assert_eq!(kept.unwrap().image::<f32>().unwrap().row(0), [1.5, 2.5]);
    }
}
