#![no_main]

libfuzzer_sys::fuzz_target!(init: consort_fuzz::prepare(), |bytes: &[u8]| consort_fuzz::hit("layout", bytes));
