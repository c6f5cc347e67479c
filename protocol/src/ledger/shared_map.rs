//! Ordered map that shares its entries with its copies.
//!
//! The entries are in chunks. A copy shares all chunks, so it costs some microseconds for thousands of entries: a snapshot
//! locks the ledger only for this time. A change copies the chunk that it changes, if a copy still shares it.

use serde::ser::SerializeMap as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt::{self, Debug};
use std::sync::Arc;

/// Maximum number of entries of a chunk. Raised: a copy is faster, and the first change of a chunk after it is slower.
const CHUNK_MAX: usize = 64;

/// Map in the order of its keys, stored and compared like a [`BTreeMap`].
#[derive(Clone)]
pub(super) struct SharedMap<K, V> {
    /// Chunks in the order of the keys. No chunk is empty.
    chunks: Vec<Arc<Vec<(K, V)>>>,
    len: usize,
}

impl<K, V> SharedMap<K, V> {
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Returns the entries, by key.
    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = (&K, &V)> {
        self.chunks.iter().flat_map(|chunk| chunk.iter().map(|(key, value)| (key, value)))
    }

    pub(super) fn values(&self) -> impl DoubleEndedIterator<Item = &V> {
        self.iter().map(|(_, value)| value)
    }
}

impl<K: Ord, V> SharedMap<K, V> {
    /// Returns the index of the chunk that contains the key, if any chunk does.
    fn chunk_of(&self, key: &K) -> usize {
        let starts_before = |chunk: &Arc<Vec<(K, V)>>| chunk.first().is_some_and(|(first, _)| first <= key);
        self.chunks.partition_point(starts_before).saturating_sub(1)
    }

    /// Returns the index of a chunk, and the position of the key in it.
    fn find(&self, key: &K) -> Option<(usize, usize)> {
        let index = self.chunk_of(key);
        let position = self.chunks.get(index)?.binary_search_by(|(other, _)| other.cmp(key)).ok()?;
        Some((index, position))
    }

    pub(super) fn get_key_value(&self, key: &K) -> Option<(&K, &V)> {
        let (index, position) = self.find(key)?;
        let (key, value) = &self.chunks[index][position];
        Some((key, value))
    }

    pub(super) fn get(&self, key: &K) -> Option<&V> {
        self.get_key_value(key).map(|(_, value)| value)
    }

    pub(super) fn contains_key(&self, key: &K) -> bool {
        self.find(key).is_some()
    }
}

impl<K: Ord + Clone, V: Clone> SharedMap<K, V> {
    pub(super) fn get_mut(&mut self, key: &K) -> Option<&mut V> {
        let (index, position) = self.find(key)?;
        let chunk = Arc::make_mut(&mut self.chunks[index]);
        Some(&mut chunk[position].1)
    }

    /// Inserts an entry, or replaces the value of its key.
    pub(super) fn insert(&mut self, key: K, value: V) {
        let index = self.chunk_of(&key);
        if self.chunks.is_empty() {
            self.chunks.push(Arc::default());
        }
        let chunk = Arc::make_mut(&mut self.chunks[index]);
        match chunk.binary_search_by(|(other, _)| other.cmp(&key)) {
            Ok(position) => {
                chunk[position].1 = value;
                return;
            }
            Err(position) => chunk.insert(position, (key, value)),
        }
        self.len += 1;
        if chunk.len() > CHUNK_MAX {
            let upper = chunk.split_off(CHUNK_MAX / 2);
            self.chunks.insert(index + 1, Arc::new(upper));
        }
    }

    pub(super) fn remove(&mut self, key: &K) -> Option<V> {
        let (index, position) = self.find(key)?;
        let (_, value) = Arc::make_mut(&mut self.chunks[index]).remove(position);
        self.len -= 1;
        if self.chunks[index].is_empty() {
            self.chunks.remove(index);
        } else {
            self.merge(index);
        }
        Some(value)
    }

    /// Merges a chunk with a neighbor if both together are at most half full, so that the number of chunks stays in
    /// proportion to the number of entries.
    fn merge(&mut self, index: usize) {
        let is_small = |lower: &usize| match self.chunks.get(*lower..*lower + 2) {
            Some([one, other]) => one.len() + other.len() <= CHUNK_MAX / 2,
            _ => false,
        };
        let Some(lower) = [index.saturating_sub(1), index].into_iter().find(is_small) else { return };
        let upper = self.chunks.remove(lower + 1);
        Arc::make_mut(&mut self.chunks[lower]).extend(Arc::unwrap_or_clone(upper));
    }
}

impl<K, V> Default for SharedMap<K, V> {
    fn default() -> SharedMap<K, V> {
        SharedMap { chunks: vec![], len: 0 }
    }
}

impl<K, V> From<BTreeMap<K, V>> for SharedMap<K, V> {
    fn from(entries: BTreeMap<K, V>) -> SharedMap<K, V> {
        let len = entries.len();
        let mut entries = entries.into_iter();
        let chunks = std::iter::from_fn(|| {
            let chunk: Vec<(K, V)> = entries.by_ref().take(CHUNK_MAX / 2).collect();
            (!chunk.is_empty()).then(|| Arc::new(chunk))
        });
        SharedMap { chunks: chunks.collect(), len }
    }
}

impl<K: PartialEq, V: PartialEq> PartialEq for SharedMap<K, V> {
    fn eq(&self, other: &SharedMap<K, V>) -> bool {
        self.len == other.len && self.iter().eq(other.iter())
    }
}

impl<K: Debug, V: Debug> Debug for SharedMap<K, V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_map().entries(self.iter()).finish()
    }
}

impl<K: Serialize, V: Serialize> Serialize for SharedMap<K, V> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.len))?;
        for (key, value) in self.iter() {
            map.serialize_entry(key, value)?;
        }
        map.end()
    }
}

impl<'de, K: Ord + Deserialize<'de>, V: Deserialize<'de>> Deserialize<'de> for SharedMap<K, V> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<SharedMap<K, V>, D::Error> {
        BTreeMap::deserialize(deserializer).map(SharedMap::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec;
    use proptest::collection::vec;
    use proptest::prelude::*;

    /// Checks the chunks, and compares the map with a plain one.
    fn check(map: &SharedMap<u16, String>, plain: &BTreeMap<u16, String>) {
        assert!(map.chunks.iter().all(|chunk| (1..=CHUNK_MAX).contains(&chunk.len())));
        assert_eq!(map.len(), plain.len());
        assert!(map.iter().eq(plain.iter()) && map.iter().rev().eq(plain.iter().rev()));
        assert!(map.values().eq(plain.values()));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_shared_map_behaves_like_a_plain_map(
            steps in vec((0_u8..4, 0_u16..400), 0..1500),
            copied in 0_usize..1500,
        ) {
            let (mut map, mut plain) = (SharedMap::<u16, String>::default(), BTreeMap::<u16, String>::new());
            let mut copies = (map.clone(), plain.clone());
            for (number, (kind, key)) in steps.into_iter().enumerate() {
                if number == copied {
                    copies = (map.clone(), plain.clone());
                }
                match kind {
                    0 | 1 => {
                        map.insert(key, number.to_string());
                        plain.insert(key, number.to_string());
                    }
                    2 => {
                        prop_assert_eq!(map.remove(&key), plain.remove(&key));
                    }
                    _ => {
                        map.get_mut(&key).into_iter().for_each(|value| value.push('x'));
                        plain.get_mut(&key).into_iter().for_each(|value| value.push('x'));
                    }
                }
                prop_assert_eq!(map.get_key_value(&key), plain.get_key_value(&key));
                prop_assert_eq!((map.get(&key), map.contains_key(&key)), (plain.get(&key), plain.contains_key(&key)));
            }
            check(&map, &plain);
            check(&copies.0, &copies.1);
            let bytes = codec::encode_record(&map).unwrap();
            prop_assert_eq!(&bytes, &codec::encode_record(&plain).unwrap());
            let read: SharedMap<u16, String> = codec::decode_record(&bytes).unwrap();
            check(&read, &plain);
            prop_assert_eq!(format!("{:?}", read), format!("{:?}", plain));
            prop_assert!(read == map);
        }
    }

    #[test]
    fn a_change_copies_a_single_chunk() {
        let mut map: SharedMap<u16, String> =
            (0..5000).map(|key| (key, String::new())).collect::<BTreeMap<_, _>>().into();
        let copy = map.clone();
        map.get_mut(&1234).unwrap().push('x');
        let shared = map.chunks.iter().zip(&copy.chunks).filter(|(one, other)| Arc::ptr_eq(one, other)).count();
        assert_eq!((shared, copy.chunks.len()), (map.chunks.len() - 1, map.chunks.len()));
        assert_eq!(copy.get(&1234).map(String::as_str), Some(""));
    }

    #[test]
    fn the_number_of_chunks_follows_the_number_of_entries() {
        let mut map = SharedMap::default();
        for key in 0..10_000_u16 {
            map.insert(key, key);
        }
        for key in (0..10_000).filter(|key| key % 100 > 0) {
            assert_eq!(map.remove(&key), Some(key));
        }
        assert_eq!(map.len(), 100);
        assert!(map.chunks.len() <= 7, "{} chunks", map.chunks.len());
    }
}
