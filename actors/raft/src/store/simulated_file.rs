//! File on a simulated disk: after a power failure, data that was written and not synced is on the disk
//! or not, independently for each sector. For tests.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use std::io;

/// Unit that a disk writes atomically, in bytes.
const SECTOR: usize = 512;

/// File on a simulated disk.
#[derive(Debug, Clone, Default)]
pub struct SimulatedFile {
    /// Content as seen by the process.
    now: Vec<u8>,
    synced: Vec<u8>,
    unsynced: Vec<Unsynced>,
}

#[derive(Debug, Clone)]
enum Unsynced {
    Length(usize),
    Write(usize, Vec<u8>),
}

impl SimulatedFile {
    /// Creates a file with this content on the disk.
    pub fn with_content(content: Vec<u8>) -> SimulatedFile {
        SimulatedFile { synced: content.clone(), now: content, unsynced: vec![] }
    }

    /// Returns the content as the process sees it, which survives the end of the process.
    pub fn content(&self) -> &[u8] {
        &self.now
    }

    /// Reads from `offset` on.
    ///
    /// # Errors
    /// The file ends earlier.
    pub fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let offset = position(offset)?;
        let found = self.now.get(offset..offset.saturating_add(out.len()));
        out.copy_from_slice(found.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    /// Changes the length; new bytes are zero.
    ///
    /// # Errors
    /// The length exceeds the memory.
    pub fn set_len(&mut self, length: u64) -> io::Result<()> {
        let length = position(length)?;
        self.now.resize(length, 0);
        self.unsynced.push(Unsynced::Length(length));
        Ok(())
    }

    /// Writes within the file.
    ///
    /// # Errors
    /// The file ends earlier.
    pub fn write(&mut self, offset: u64, data: &[u8]) -> io::Result<()> {
        let offset = position(offset)?;
        let target = self.now.get_mut(offset..offset.saturating_add(data.len()));
        target.ok_or(io::ErrorKind::UnexpectedEof)?.copy_from_slice(data);
        self.unsynced.push(Unsynced::Write(offset, data.to_vec()));
        Ok(())
    }

    /// Puts everything that was written on the disk.
    pub fn sync(&mut self) {
        for operation in std::mem::take(&mut self.unsynced) {
            match operation {
                Unsynced::Length(length) => self.synced.resize(length, 0),
                Unsynced::Write(offset, data) => {
                    // The file may have been cut since.
                    let end = self.synced.len().min(offset + data.len());
                    if offset < end {
                        self.synced[offset..end].copy_from_slice(&data[..end - offset]);
                    }
                }
            }
        }
    }

    /// Returns the content of the disk after a power failure at this moment.
    pub fn after_power_failure(&self, rng: &mut ChaCha8Rng) -> Vec<u8> {
        let mut remaining = self.synced.clone();
        let survival_chance = rng.random_range(0..=4_u8);
        let mut survives = || rng.random_range(0..4) < survival_chance;
        for operation in &self.unsynced {
            match operation {
                Unsynced::Length(length) => {
                    if survives() {
                        remaining.resize(*length, 0);
                    }
                }
                Unsynced::Write(offset, data) => {
                    let mut done = 0;
                    while done < data.len() {
                        let position = offset + done;
                        let length = (SECTOR - position % SECTOR).min(data.len() - done);
                        // There is nothing beyond the end of a file that did not grow.
                        if survives() && position + length <= remaining.len() {
                            remaining[position..position + length].copy_from_slice(&data[done..done + length]);
                        }
                        done += length;
                    }
                }
            }
        }
        remaining
    }
}

fn position(offset: u64) -> io::Result<usize> {
    usize::try_from(offset).map_err(|_| io::ErrorKind::FileTooLarge.into())
}
