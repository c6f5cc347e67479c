//! Files of the archive: a JSON object per line, in files by day that are also limited in size.

use super::record::ArchiveRecord;
use crate::config::ArchiveConfig;
use std::fs::{self, File};
use std::io::{self, BufRead as _, BufReader, BufWriter, Write as _};
use std::path::{Path, PathBuf};
use time::{Date, OffsetDateTime};

/// Folder of the archive in the data directory.
pub(crate) const FOLDER: &str = "archive";

/// Size from which a file is continued by another, in bytes. The earliest file is removed as a whole.
const FILE_BYTES: u64 = 4 << 20;

/// Extension of the files.
const EXTENSION: &str = "jsonl";

/// The files of an archive that is written.
#[derive(Debug)]
pub(crate) struct ArchiveFiles {
    folder: PathBuf,
    limits: ArchiveConfig,
    open: Option<OpenFile>,
    /// Records were appended since the last flush.
    is_dirty: bool,
}

#[derive(Debug)]
struct OpenFile {
    date: Date,
    path: PathBuf,
    writer: BufWriter<File>,
    bytes: u64,
}

impl ArchiveFiles {
    /// Opens the archive in a folder, which is created if it does not exist.
    ///
    /// # Errors
    /// The error of the system.
    pub(crate) fn open(folder: PathBuf, limits: ArchiveConfig) -> io::Result<ArchiveFiles> {
        fs::create_dir_all(&folder)?;
        Ok(ArchiveFiles { folder, limits, open: None, is_dirty: false })
    }

    /// Returns the path of another file in the folder.
    pub(super) fn path_of(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Appends a record. `now_ms` is the time of day in milliseconds since 1970.
    pub(super) fn append(&mut self, record: &ArchiveRecord, now_ms: u64) -> io::Result<()> {
        let mut line = serde_json::to_vec(record).expect("a record has a JSON form");
        line.push(b'\n');
        self.is_dirty = true;
        let file = self.file_of(date_of(now_ms))?;
        file.bytes += line.len() as u64;
        file.writer.write_all(&line)
    }

    /// Writes the records to the system, and removes the earliest files beyond the limits.
    pub(super) fn flush(&mut self, now_ms: u64) -> io::Result<()> {
        if !std::mem::take(&mut self.is_dirty) {
            return Ok(());
        }
        if let Some(file) = &mut self.open {
            file.writer.flush()?;
        }
        let oldest =
            date_of(now_ms).to_julian_day().saturating_sub(i32::try_from(self.limits.days).unwrap_or(i32::MAX));
        let files = files_of(&self.folder)?;
        let mut bytes: u64 = files.iter().map(|file| file.bytes).sum();
        for file in files {
            let is_over = bytes > u64::from(self.limits.megabytes) * 1_000_000 || file.date.to_julian_day() < oldest;
            if !is_over || self.open.as_ref().is_some_and(|open| open.path == file.path) {
                return Ok(());
            }
            fs::remove_file(&file.path)?;
            bytes -= file.bytes;
        }
        Ok(())
    }

    /// Waits until the disk has the records that were flushed, so that a loss of power loses none.
    pub(super) fn sync(&self) -> io::Result<()> {
        if let Some(file) = &self.open {
            file.writer.get_ref().sync_data()?;
        }
        File::open(&self.folder)?.sync_all() // the names of the files
    }

    /// Returns the file for a day: the open one, or another after the files of this day.
    fn file_of(&mut self, date: Date) -> io::Result<&mut OpenFile> {
        let is_continued = self.open.as_ref().is_some_and(|open| open.date == date && open.bytes < FILE_BYTES);
        if !is_continued {
            if let Some(mut full) = self.open.take() {
                full.writer.flush()?;
                full.writer.get_ref().sync_data()?;
            }
            let numbers = files_of(&self.folder)?.into_iter().filter(|file| file.date == date).map(|file| file.number);
            let number = numbers.max().unwrap_or(0) + 1;
            let path = self.folder.join(format!("{date}-{number:04}.{EXTENSION}"));
            let writer = BufWriter::new(File::options().create_new(true).write(true).open(&path)?);
            self.open = Some(OpenFile { date, path, writer, bytes: 0 });
        }
        Ok(self.open.as_mut().expect("it was opened above"))
    }
}

/// A file of the archive.
struct ArchiveFile {
    date: Date,
    number: u32,
    path: PathBuf,
    bytes: u64,
}

/// Returns the files of an archive, earliest first.
fn files_of(folder: &Path) -> io::Result<Vec<ArchiveFile>> {
    let mut files = vec![];
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_none_or(|extension| extension != EXTENSION) {
            continue;
        }
        let name = path.file_stem().and_then(|stem| stem.to_str()).and_then(|stem| stem.rsplit_once('-'));
        let parsed = name.and_then(|(date, number)| Some((parse_date(date)?, number.parse().ok()?)));
        if let Some((date, number)) = parsed {
            // The station may have removed it meanwhile.
            let Ok(bytes) = path.metadata().map(|metadata| metadata.len()) else { continue };
            files.push(ArchiveFile { date, number, path, bytes });
        }
    }
    files.sort_by_key(|file| (file.date, file.number));
    Ok(files)
}

/// Parses the date of a file: `2026-11-27`.
fn parse_date(text: &str) -> Option<Date> {
    let mut parts = text.splitn(3, '-');
    let (year, month, day) = (parts.next()?, parts.next()?, parts.next()?);
    let month: u8 = month.parse().ok()?;
    Date::from_calendar_date(year.parse().ok()?, month.try_into().ok()?, day.parse().ok()?).ok()
}

/// Returns the date of a time in milliseconds since 1970, in UTC.
fn date_of(at_ms: u64) -> Date {
    let seconds = i64::try_from(at_ms / 1000).unwrap_or(0);
    OffsetDateTime::from_unix_timestamp(seconds).unwrap_or(OffsetDateTime::UNIX_EPOCH).date()
}

/// Passes all records of an archive to `receive`, earliest first. Returns the number of lines that cannot be read: the last
/// line of a station that was killed, or records of a later release.
///
/// # Errors
/// The error of the system, or the first error of `receive`.
pub(crate) fn read_all<E: From<io::Error>>(
    folder: &Path,
    mut receive: impl FnMut(ArchiveRecord) -> Result<(), E>,
) -> Result<usize, E> {
    let mut unreadable = 0;
    for file in files_of(folder)? {
        let opened = match File::open(&file.path) {
            // The station has removed it meanwhile.
            Err(problem) if problem.kind() == io::ErrorKind::NotFound => continue,
            opened => opened?,
        };
        for line in BufReader::new(opened).split(b'\n') {
            match serde_json::from_slice(&line?) {
                Ok(record) => receive(record)?,
                Err(_) => unreadable += 1,
            }
        }
    }
    Ok(unreadable)
}

#[cfg(test)]
mod tests {
    use super::super::record::ArchiveContent;
    use super::*;
    use consort_protocol::ledger::{AuditAction, AuditEntry};

    const DAY_MS: u64 = 24 * 60 * 60 * 1000;

    /// A folder that is removed when dropped.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Folder {
            let folder = std::env::temp_dir().join(format!("consort-archive-{name}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&folder);
            Folder(folder)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    fn record(number: u64, bytes: usize) -> ArchiveRecord {
        let (by, action, subject) = ("Nia".to_owned(), AuditAction::Cancel, "m-1".to_owned());
        let entry = AuditEntry { number, at_ms: 1, by, action, subject, details: "x".repeat(bytes) };
        ArchiveRecord { at_ms: 1, content: ArchiveContent::Audit(entry) }
    }

    /// Returns the numbers of the records, and the number of unreadable lines.
    fn numbers(folder: &Path) -> (Vec<u64>, usize) {
        let mut numbers = vec![];
        let unreadable = read_all(folder, |record| {
            if let ArchiveContent::Audit(entry) = record.content {
                numbers.push(entry.number);
            }
            Ok::<(), io::Error>(())
        });
        (numbers, unreadable.unwrap())
    }

    #[test]
    fn records_are_read_in_order_also_after_a_crash() {
        let folder = Folder::new("order");
        let limits = ArchiveConfig { days: 9, megabytes: 9 };
        for number in [1, 2] {
            let mut files = ArchiveFiles::open(folder.0.clone(), limits).unwrap();
            files.append(&record(number, 1), DAY_MS).unwrap();
            files.flush(DAY_MS).unwrap();
            // The next line was written in part.
            let written = files_of(&folder.0).unwrap().pop().unwrap();
            fs::OpenOptions::new().append(true).open(written.path).unwrap().write_all(b"{\"at_ms\": 1").unwrap();
        }
        assert_eq!(numbers(&folder.0), (vec![1, 2], 2));
    }

    #[test]
    fn the_earliest_files_are_removed_by_size_and_by_age() {
        let folder = Folder::new("limits");
        let limits = ArchiveConfig { days: 2, megabytes: 10 };
        let mut files = ArchiveFiles::open(folder.0.clone(), limits).unwrap();
        for number in 0..40 {
            files.append(&record(number, 1_000_000), DAY_MS).unwrap();
            files.flush(DAY_MS).unwrap();
        }
        let (kept, _) = numbers(&folder.0);
        let bytes: u64 = files_of(&folder.0).unwrap().iter().map(|file| file.bytes).sum();
        assert!(kept.last() == Some(&39) && kept.len() >= 5 && bytes <= 10_000_000, "{kept:?}");
        files.append(&record(40, 1), 4 * DAY_MS).unwrap();
        files.flush(4 * DAY_MS).unwrap();
        assert_eq!(numbers(&folder.0), (vec![40], 0));
    }
}
