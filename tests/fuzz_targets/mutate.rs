//! Random mutations of inputs, both by the rules of a format and by plain corruption.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Problematic tokens: numeric limits, nesting, references, entities, escapes.
const TROUBLE: &[&[u8]] = &[
    b"0",
    b"-1",
    b"1e308",
    b"-1e-308",
    b"NaN",
    b".inf",
    b"18446744073709551615",
    b"-9223372036854775808",
    b"99999999999999999999999999",
    b"[[[[[[[[",
    b"]]]]]]]]",
    b"{\"a\":{\"a\":",
    b"&a ",
    b"*a",
    b"<<: *a\n",
    b"!!binary ",
    b"<!DOCTYPE a [<!ENTITY b \"bbbb\">]>",
    b"&b;",
    b"<![CDATA[",
    b"<a>",
    b"</a>",
    b"\\u0000",
    b"\\ud800",
    b"%00",
    b"\"\"",
    b"\n",
    b"\t",
    b"- ",
    b": ",
    b"null",
    b"true",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\xf0\x9f\xa4\x96",
    b"\x00",
    b"\xfd\xff\xff\xff\xff\xff\xff\xff\xff",
    b"\xfc\xff\xff\xff\xff",
    b"\xfb\xff\xff",
    b"\xfd\x00\x00\x00\x00\x00\x00\x00\x40",
];

/// Largest size of a mutated input, in bytes.
const LONG: usize = 256 * 1024;

/// Generator of mutated inputs. The same name and seed produce the same inputs.
pub(crate) struct Mutator {
    rng: ChaCha8Rng,
    pool: Vec<Vec<u8>>,
    words: Vec<Vec<u8>>,
}

impl Mutator {
    pub(crate) fn new<'a>(name: &str, seed: u64, pool: impl Iterator<Item = &'a Vec<u8>>) -> Mutator {
        let named =
            name.bytes().fold(seed, |sum, byte| sum.wrapping_mul(0x100_0000_01b3).wrapping_add(u64::from(byte)));
        let mut pool: Vec<Vec<u8>> = pool.cloned().collect();
        if pool.is_empty() {
            pool.push(vec![]);
        }
        let mut words: Vec<Vec<u8>> = TROUBLE.iter().map(|word| word.to_vec()).collect();
        for input in &pool {
            let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || b"_-.".contains(byte);
            let found = input.split(|byte| !is_word(byte)).filter(|word| (2..24).contains(&word.len()));
            words.extend(found.take(400).map(<[u8]>::to_vec));
        }
        words[TROUBLE.len()..].sort();
        words.dedup();
        Mutator { rng: ChaCha8Rng::seed_from_u64(named), pool, words }
    }

    fn below(&mut self, limit: usize) -> usize {
        if limit == 0 { 0 } else { self.rng.random_range(0..limit) }
    }

    /// Returns the next input: an input of the pool with at least one mutation.
    pub(crate) fn next(&mut self) -> Vec<u8> {
        let chosen = self.below(self.pool.len());
        let mut input = self.pool[chosen].clone();
        for _ in 0..=self.below(5) {
            self.change(&mut input);
        }
        input.truncate(LONG);
        input
    }

    fn change(&mut self, input: &mut Vec<u8>) {
        let at = self.below(input.len() + 1);
        let end = at + self.below(input.len().saturating_sub(at).min(64) + 1);
        match self.below(10) {
            // Flip a bit, replace a byte.
            0 if at < input.len() => input[at] ^= 1 << self.below(8),
            1 if at < input.len() => input[at] = self.rng.random(),
            // Truncate, cut a piece out.
            2 => input.truncate(at),
            3 => drop(input.drain(at..end)),
            // Repeat a piece, at times very often.
            4 => {
                let piece = input[at..end].to_vec();
                let times = if self.below(20) == 0 { 2000 } else { 1 + self.below(4) };
                input.splice(at..at, piece.repeat(times));
            }
            // Insert a token, or replace a piece by a token.
            5 | 6 => {
                let word = self.word();
                input.splice(at..at, word);
            }
            7 => {
                let word = self.word();
                input.splice(at..end, word);
            }
            // Replace the next token by another.
            8 => self.exchange(input, at),
            // Append the end of another input.
            _ => {
                let other = self.below(self.pool.len());
                let from = self.below(self.pool[other].len() + 1);
                input.truncate(at);
                input.extend_from_slice(&self.pool[other][from..]);
            }
        }
    }

    fn word(&mut self) -> Vec<u8> {
        // Half of the tokens are problematic.
        let among = if self.below(2) == 0 { TROUBLE.len() } else { self.words.len() };
        let chosen = self.below(among);
        self.words[chosen].clone()
    }

    fn exchange(&mut self, input: &mut Vec<u8>, from: usize) {
        let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || b"_-.".contains(byte);
        let Some(begin) = input[from..].iter().position(is_word).map(|after| from + after) else { return };
        let length = input[begin..].iter().take_while(|byte| is_word(byte)).count();
        let word = self.word();
        input.splice(begin..begin + length, word);
    }
}
