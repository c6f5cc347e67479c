//! Process metrics from the system, under the names of Prometheus' own libraries. Linux provides
//! them in `/proc`; on other systems these metrics are absent.

use super::sampled_metric::SampledMetric;
use procfs_core::prelude::*;
use procfs_core::process::{LimitValue, Limits, Stat, Status};
use procfs_core::{ExplicitSystemInfo, KernelStats, ProcResult};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::DescriptorEncoder;
use std::fmt;
use std::fs::{self, File};
use std::io::Read;

/// Linux reports times to programs in hundredths of a second, whatever its internal unit.
const TICKS_PER_SECOND: u64 = 100;

const KIBIBYTE: u64 = 1024;

/// Samples this process.
#[derive(Debug)]
pub(super) struct ProcessCollector;

impl Collector for ProcessCollector {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let Some(usage) = Usage::now() else { return Ok(()) };
        usage.levels().iter().try_for_each(|level| level.encode(&mut encoder))
    }
}

/// Resource usage of this process.
#[derive(Debug, PartialEq)]
struct Usage {
    cpu_s: f64,
    resident_bytes: u64,
    virtual_bytes: u64,
    open_files: usize,
    open_files_max: Option<u64>,
    started_s: f64,
}

impl Usage {
    fn now() -> Option<Usage> {
        let file = |name: &str| File::open(format!("/proc/{name}"));
        // The folder being read is open itself.
        let open_files = fs::read_dir("/proc/self/fd").ok()?.count().saturating_sub(1);
        let (stat, status) = (file("self/stat").ok()?, file("self/status").ok()?);
        let (limits, kernel) = (file("self/limits").ok()?, file("stat").ok()?);
        Usage::read(stat, status, limits, kernel, open_files).ok()
    }

    fn read(
        stat: impl Read,
        status: impl Read,
        limits: impl Read,
        kernel: impl Read,
        open_files: usize,
    ) -> ProcResult<Usage> {
        let (stat, status, limits) = (Stat::from_read(stat)?, Status::from_read(status)?, Limits::from_read(limits)?);
        // Only the ticks matter here.
        let system = ExplicitSystemInfo {
            boot_time_secs: 0,
            ticks_per_second: TICKS_PER_SECOND,
            page_size: 4 * KIBIBYTE,
            is_little_endian: cfg!(target_endian = "little"),
        };
        let kernel = KernelStats::from_read(kernel, &system)?;
        let seconds = |ticks: u64| ticks as f64 / TICKS_PER_SECOND as f64;
        Ok(Usage {
            cpu_s: seconds(stat.utime + stat.stime),
            resident_bytes: status.vmrss.unwrap_or(0) * KIBIBYTE,
            virtual_bytes: stat.vsize,
            open_files,
            open_files_max: match limits.max_open_files.soft_limit {
                LimitValue::Value(most) => Some(most),
                LimitValue::Unlimited => None,
            },
            started_s: kernel.btime as f64 + seconds(stat.starttime),
        })
    }

    fn levels(&self) -> Vec<SampledMetric> {
        let gauge = |name, help, value: u64| SampledMetric::gauge(name, help, value as f64);
        let cpu = SampledMetric::counter("process_cpu_seconds", "Processor time spent in all threads", self.cpu_s);
        let start =
            SampledMetric::gauge("process_start_time_seconds", "Start of the process, since 1970", self.started_s);
        let mut levels = vec![
            cpu,
            gauge("process_resident_memory_bytes", "Memory in use", self.resident_bytes),
            gauge("process_virtual_memory_bytes", "Memory reserved", self.virtual_bytes),
            gauge("process_open_fds", "Open files and connections", self.open_files as u64),
            start,
        ];
        levels.extend(
            self.open_files_max
                .map(|most| gauge("process_max_fds", "Maximum number of open files and connections", most)),
        );
        levels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_values_of_linux_are_converted_to_seconds_and_bytes() {
        let stat = "42 (a (b) c) S 1 42 42 0 -1 4194560 1013 0 0 0 150 75 0 0 20 0 9 0 12345 276480000 6500 \
                    18446744073709551615 1 1 0 0 0 0 0 4096 17442 0 0 0 17 1 0 0 0 0 0 0 0 0 0 0 0 0 0";
        let status = "Name:\ta\nUmask:\t0022\nState:\tS (sleeping)\nTgid:\t42\nNgid:\t0\nPid:\t42\nPPid:\t1\nTracerPid:\t0\n\
                      Uid:\t0\t0\t0\t0\nGid:\t0\t0\t0\t0\nFDSize:\t64\nGroups:\t0\nVmSize:\t 270000 kB\nVmRSS:\t 26000 kB\n\
                      Threads:\t9\nSigQ:\t0/1\nSigPnd:\t0\nShdPnd:\t0\nSigBlk:\t0\nSigIgn:\t0\nSigCgt:\t0\nCapInh:\t0\n\
                      CapPrm:\t0\nCapEff:\t0\nvoluntary_ctxt_switches:\t1\nnonvoluntary_ctxt_switches:\t2\n";
        let names = [
            "cpu time",
            "file size",
            "data size",
            "stack size",
            "core file size",
            "resident set",
            "processes",
            "open files",
            "locked memory",
            "address space",
            "file locks",
            "pending signals",
            "msgqueue size",
            "nice priority",
            "realtime priority",
            "realtime timeout",
        ];
        let most = |name: &&str| if *name == "open files" { "1024" } else { "unlimited" };
        let unit = |name: &&str| if name.ends_with("priority") { "" } else { "units" };
        let line =
            |name: &&str| format!("{:<26}{:<21}{:<21}{}\n", format!("Max {name}"), most(name), "unlimited", unit(name));
        let limits: String = names.iter().map(line).collect();
        let limits = format!("{:<26}{:<21}{:<21}Units\n{limits}", "Limit", "Soft Limit", "Hard Limit");
        let kernel = "cpu  1 2 3 4 5 6 7 8 9 10\ncpu0 1 2 3 4 5 6 7 8 9 10\nintr 1\nctxt 2\nbtime 1700000000\nprocesses 3\n\
                      procs_running 1\nprocs_blocked 0\nsoftirq 1\n";
        let read = Usage::read(stat.as_bytes(), status.as_bytes(), limits.as_bytes(), kernel.as_bytes(), 17);
        let expected = Usage {
            cpu_s: 2.25,
            resident_bytes: 26_000 * 1024,
            virtual_bytes: 276_480_000,
            open_files: 17,
            open_files_max: Some(1024),
            started_s: 1_700_000_123.45,
        };
        assert_eq!(read.unwrap(), expected);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_running_process_is_measured() {
        let before = Usage::now().expect("Linux has /proc");
        let (files, memory) = ([(); 40].map(|()| File::open("/proc/self/stat").unwrap()), vec![7_u8; 64 << 20]);
        let after = Usage::now().expect("Linux has /proc");
        assert!(after.open_files >= before.open_files + files.len() - 20, "{before:?} {after:?}");
        assert!(after.resident_bytes >= before.resident_bytes + (48 << 20), "{before:?} {after:?}");
        assert_eq!(after.started_s, before.started_s);
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
        assert!((now - 3600.0..=now + 1.0).contains(&after.started_s), "{after:?} at {now}");
        assert_eq!(memory.iter().map(|byte| usize::from(*byte)).sum::<usize>(), 7 * memory.len());
    }
}
