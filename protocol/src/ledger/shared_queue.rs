//! Queue that shares its elements with its copies, in chunks like a [`SharedMap`](super::shared_map::SharedMap).

use serde::ser::SerializeSeq as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::VecDeque;
use std::fmt::{self, Debug};
use std::sync::Arc;

/// Maximum number of elements of a chunk. Raised: a copy is faster, and the first change after it is slower.
const CHUNK_MAX: usize = 64;

/// Queue, stored and compared like a [`VecDeque`].
#[derive(Clone)]
pub(super) struct SharedQueue<T> {
    /// Chunks in the order of the elements. Only the last may have less than [`CHUNK_MAX`] elements, and none is empty.
    chunks: VecDeque<Arc<Vec<T>>>,
    /// Number of elements of the first chunk that have been removed: fewer than it has.
    removed: usize,
}

impl<T> SharedQueue<T> {
    pub(super) fn len(&self) -> usize {
        match self.chunks.back() {
            Some(last) => (self.chunks.len() - 1) * CHUNK_MAX + last.len() - self.removed,
            None => 0,
        }
    }

    pub(super) fn get(&self, index: usize) -> Option<&T> {
        let index = self.removed + index;
        self.chunks.get(index / CHUNK_MAX)?.get(index % CHUNK_MAX)
    }

    pub(super) fn front(&self) -> Option<&T> {
        self.get(0)
    }

    pub(super) fn back(&self) -> Option<&T> {
        self.chunks.back()?.last()
    }

    /// Returns the elements, earliest first.
    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        (0..self.len()).filter_map(move |index| self.get(index))
    }
}

impl<T: Clone> SharedQueue<T> {
    pub(super) fn push_back(&mut self, element: T) {
        match self.chunks.back_mut() {
            Some(last) if last.len() < CHUNK_MAX => Arc::make_mut(last).push(element),
            _ => self.chunks.push_back(Arc::new(vec![element])),
        }
    }

    pub(super) fn pop_front(&mut self) -> Option<T> {
        let first = self.chunks.front()?;
        let element = first.get(self.removed)?.clone();
        self.removed += 1;
        if self.removed == first.len() {
            self.chunks.pop_front();
            self.removed = 0;
        }
        Some(element)
    }
}

impl<T> Default for SharedQueue<T> {
    fn default() -> SharedQueue<T> {
        SharedQueue { chunks: VecDeque::new(), removed: 0 }
    }
}

impl<T: PartialEq> PartialEq for SharedQueue<T> {
    fn eq(&self, other: &SharedQueue<T>) -> bool {
        self.len() == other.len() && self.iter().eq(other.iter())
    }
}

impl<T: Debug> Debug for SharedQueue<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<T: Serialize> Serialize for SharedQueue<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut sequence = serializer.serialize_seq(Some(self.len()))?;
        for element in self.iter() {
            sequence.serialize_element(element)?;
        }
        sequence.end()
    }
}

impl<'de, T: Clone + Deserialize<'de>> Deserialize<'de> for SharedQueue<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<SharedQueue<T>, D::Error> {
        let mut queue = SharedQueue::default();
        Vec::<T>::deserialize(deserializer)?.into_iter().for_each(|element| queue.push_back(element));
        Ok(queue)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec;

    fn check(queue: &SharedQueue<usize>, plain: &VecDeque<usize>) {
        assert!(queue.chunks.iter().all(|chunk| !chunk.is_empty()));
        assert_eq!((queue.len(), queue.front(), queue.back()), (plain.len(), plain.front(), plain.back()));
        assert!(queue.iter().eq(plain.iter()) && queue.iter().rev().eq(plain.iter().rev()));
        for index in [0, 1, plain.len() / 2, plain.len()] {
            assert_eq!(queue.get(index), plain.get(index));
        }
    }

    #[test]
    fn a_shared_queue_behaves_like_a_plain_queue() {
        for popped in 1..=4 {
            let (mut queue, mut plain) = (SharedQueue::<usize>::default(), VecDeque::<usize>::new());
            for round in 0..400 {
                let copies = (queue.clone(), plain.clone());
                let pushed = if round < 200 { 3 } else { 0 };
                for element in 0..pushed {
                    queue.push_back(round + element);
                    plain.push_back(round + element);
                }
                for _ in 0..popped {
                    assert_eq!(queue.pop_front(), plain.pop_front());
                }
                check(&queue, &plain);
                check(&copies.0, &copies.1);
            }
            let bytes = codec::encode_record(&queue).unwrap();
            assert_eq!(bytes, codec::encode_record(&plain).unwrap());
            let read: SharedQueue<usize> = codec::decode_record(&bytes).unwrap();
            assert!(read == queue);
            assert_eq!(format!("{read:?}"), format!("{plain:?}"));
        }
    }

    #[test]
    fn a_copy_shares_the_elements() {
        let mut queue = SharedQueue::default();
        (0..1000).for_each(|element| queue.push_back(element));
        let copy = queue.clone();
        queue.push_back(1000);
        queue.pop_front();
        let shared = queue.chunks.iter().zip(&copy.chunks).filter(|(one, other)| Arc::ptr_eq(one, other)).count();
        assert_eq!((shared, copy.len()), (copy.chunks.len() - 1, 1000));
    }
}
