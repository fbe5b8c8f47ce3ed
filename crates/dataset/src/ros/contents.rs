use std::collections::BTreeMap;
use std::path::Path;

use locsim_core::limits::{Limits, quoted};

use super::bag::{Bag, Channel, Tally};
use super::messages::{
    LaserScan, MULTI_ECHO_LASER_SCAN, Message, MultiEchoLaserScan, POINT_CLOUD_2, TfMessage, decode,
};
use super::poses::plain;
use crate::contents::{Topic, TransformPair, decimal, rate_hz};
use crate::{DatasetError, LogContents, LogFormat, Scanner, ScannerBeams};

/// Pairs of frames that are listed, at the most; robots have hundreds.
const MOST_PAIRS: usize = 1000;

/// The contents of a bag. Messages that can't be decoded are counted all the same.
pub fn contents(path: &Path, limits: &Limits) -> Result<LogContents, DatasetError> {
    let bag = Bag::open(path, limits)?;
    let tallies = bag.tallies()?;
    let of_type = |kind: &str| -> Vec<&Channel> {
        let right = |(channel, tally): &(&Channel, &Tally)| channel.schema == kind && tally.messages > 0;
        tallies.iter().filter(right).map(|(channel, _)| channel).collect()
    };
    let scans = [of_type(LaserScan::TYPE), of_type(MULTI_ECHO_LASER_SCAN)].concat();
    let clouds = of_type(POINT_CLOUD_2);
    let transforms = of_type(TfMessage::TYPE);
    let mut beams = BTreeMap::<&str, ScannerBeams>::new();
    let mut pairs = BTreeMap::<(String, bool), Tally>::new();
    bag.read(&[scans.clone(), transforms.clone()].concat(), |channel, data| {
        if let Some(scanner) = scans.iter().find(|scan| **scan == channel) {
            if !beams.contains_key(scanner.topic.as_str())
                && let Ok(found) = scanner_beams(&scanner.schema, data)
            {
                beams.insert(&scanner.topic, found);
            }
            return Ok(());
        }
        let is_static = channel.topic.ends_with("tf_static");
        let TfMessage { transforms } = decode(data).unwrap_or_default();
        for transform in transforms {
            let [parent, child] =
                [&transform.header.frame_id, &transform.child_frame_id].map(|frame| quoted(plain(frame)));
            let key = (format!("{parent}:{child}"), is_static);
            if pairs.len() < MOST_PAIRS || pairs.contains_key(&key) {
                pairs.entry(key).or_default().add(transform.header.stamp.nanos());
            }
        }
        Ok(())
    })?;
    let scanners = scans.iter().chain(&clouds).map(|channel| Scanner {
        source: quoted(&channel.topic),
        scans: tallies[*channel].messages,
        beams: beams.get(channel.topic.as_str()).cloned(),
    });
    let topics = tallies.iter().map(|(channel, tally)| Topic {
        name: quoted(&channel.topic),
        kind: quoted(&channel.schema),
        messages: tally.messages,
        rate_hz: tally.logged.and_then(|logged| rate_hz(tally.messages, logged)),
        longest_gap_secs: (tally.messages > 1).then_some(tally.longest_gap as f64 * 1e-9),
    });
    let transforms = pairs.iter().map(|((frames, is_static), tally)| TransformPair {
        frames: frames.clone(),
        is_static: *is_static,
        messages: tally.messages,
        rate_hz: tally.logged.and_then(|stamps| rate_hz(tally.messages, stamps)),
    });
    Ok(LogContents {
        format: LogFormat::Bag,
        topics: topics.collect(),
        scanners: scanners.collect(),
        transforms: transforms.collect(),
    })
}

fn scanner_beams(schema: &str, data: &[u8]) -> Result<ScannerBeams, String> {
    let scan: LaserScan = match schema {
        MULTI_ECHO_LASER_SCAN => decode::<MultiEchoLaserScan>(data)?.into(),
        _ => decode(data)?,
    };
    Ok(ScannerBeams {
        frame: quoted(plain(&scan.header.frame_id)),
        count: scan.ranges.len(),
        first_rad: scan.angle_min.into(),
        step_rad: scan.angle_increment.into(),
        min_range_m: decimal(scan.range_min),
        max_range_m: decimal(scan.range_max),
    })
}
