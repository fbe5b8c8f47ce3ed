//! Maps that can't be read, or can't be ones.

use predicates::str::{contains, starts_with};

use crate::common::{Folder, SCENARIO, edited, output};
use crate::{ON_A_LOG, refused};

#[test]
fn maps() {
    let folder = Folder::new();
    let room = String::from_utf8(folder.read("room.yaml")).unwrap();
    folder.write("room.yaml", edited(&room, "[1.8, 1.5]", "[1.8, .nan]"));
    refused(
        &folder,
        "run room-run.yaml",
        "room.yaml:6: obstacles[0].points_m[1]: point 1 of `pillar` is not finite: [1.8, NaN]",
    );

    folder.write(
        "room.yaml",
        "image: room.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n",
    );
    refused(
        &folder,
        "run room-run.yaml",
        "room.yaml:1: image: map image room.pgm: No such file or directory (os error 2)",
    );
}

/// Values of a map's file are short in errors, and nothing in them acts on a terminal.
#[test]
fn long_and_hidden_values_of_maps() {
    let folder = Folder::new();
    let room = String::from_utf8(folder.read("room.yaml")).unwrap();
    folder.locsim("inspect \u{1b}[31mX").code(2).stderr(starts_with("error: \\u{1b}[31mX: cannot be opened"));
    let long = "n".repeat(500);
    let cut = format!("{}..", "n".repeat(76));
    let walls = format!("walls: [{{name: \"\\e[1m{long}\", from_m: [1, 1], to_m: [2, 1]}}]\n");
    let twice =
        walls.replace("]}]", &format!("]}}, {{name: \"\\e[1m{long}\", from_m: [1, 1], to_m: [2, 1]}}]"));
    folder.write("room.yaml", room.clone() + &twice);
    let name = format!("`\\u{{1b}}[1m{cut}`");
    let call = folder.locsim("run room-run.yaml").code(2);
    call.stderr(contains(format!("the name {name} is given twice, the second time in {name}")));
    let ros = "image: IMAGE\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n";
    for (image, told) in [
        ("\"\\e[31mX\\nY\"".to_owned(), "map image \\u{1b}[31mX\\nY: No such file".to_owned()),
        (long, format!("map image {}..: File name too long", "n".repeat(80))),
    ] {
        folder.write("room.yaml", edited(ros, "IMAGE", &image));
        folder.locsim("run room-run.yaml").code(2).stderr(contains(format!("room.yaml:1: image: {told}")));
    }
    folder.write("room.yaml", edited(ros, "0.65", "1e308"));
    folder.locsim("run room-run.yaml").code(2).stderr(contains("got 0.2 and 1e308\n"));
    for (from, to, told) in [
        (
            "[1.8, 1.5]",
            "[1e300, 1.5]",
            "point 1 of `pillar` is not allowed: [1e300, 1.5]; coordinates are metres",
        ),
        (
            "[0, 0], [3.2, 0]",
            "[0, 0], [3.2, 2.5]",
            "outline: edges 0 and 6 of `room` cross each other; an outline has one inside",
        ),
    ] {
        folder.write("room.yaml", edited(&room, from, to));
        folder.locsim("run room-run.yaml").code(2).stderr(contains(told));
    }
    folder.write("room.yaml", "outline: {points_m: [[0, 0], [5, 0], [10, 0]]}\n");
    refused(
        &folder,
        "run room-run.yaml",
        "room.yaml:1: outline: `outline` has no area: its points lie on one line",
    );
    folder.write("room.yaml", room + "walls:\n  - {name: far, from_m: [1e6, 1], to_m: [1e6, 2]}\n");
    refused(
        &folder,
        "validate room-run.yaml",
        "room.yaml:8: walls[0].from_m: point 0 of `far` is not allowed: [1000000, 1]; at most 10000 m beyond the outline, as no \
         laser reaches farther",
    );
}

#[test]
fn samples_above_the_greatest_of_an_image() {
    let folder = Folder::new();
    ros_map(&folder, 0, 254, "negate: 0\n");
    let image = folder.read("floor.pgm");
    let as_said = [b"P5\n36 22\n100\n", &image[image.len() - 36 * 22..]].concat();
    folder.write("floor.pgm", as_said);
    folder.write("s.yaml", edited(SCENARIO, "room.yaml", "floor.yaml"));
    refused(
        &folder,
        "run s.yaml",
        "floor.yaml:1: image: map image floor.pgm: it has a sample of 254; at most 100, the greatest that its header tells",
    );
}

/// The decoder's own words stand beside what is needed.
#[test]
fn images_that_cannot_be_decoded() {
    let folder = Folder::new();
    ros_map(&folder, 0, 254, "negate: 0\n");
    folder.write("s.yaml", edited(SCENARIO, "room.yaml", "floor.yaml"));
    let needed = "a whole image in PNG or PGM is needed";
    for (image, reason) in [
        (&b"P5\n36 22\n70000\n"[..], "Format error decoding Pnm: Image MAXVAL exceeds 65535: 70000"),
        (&b"P5\n36 22\n0\n"[..], "Format error decoding Pnm: Image MAXVAL is zero"),
    ] {
        folder.write("floor.pgm", image);
        let message =
            format!("floor.yaml:1: image: map image floor.pgm: it can't be decoded ({reason}); {needed}");
        refused(&folder, "validate s.yaml", &message);
    }
}

/// Short walls cost their range table most of a run's time, and the estimate says so.
#[test]
fn a_map_of_many_corners_has_its_time_told() {
    let folder = Folder::new();
    let told = |corners: u32| -> f64 {
        let corner = |i| {
            let angle = f64::from(i) * std::f64::consts::TAU / f64::from(corners);
            format!("[{}, {}]", 1.6 + 3.0 * angle.cos(), 0.9 + 3.0 * angle.sin())
        };
        let corners: Vec<String> = (0..corners).map(corner).collect();
        folder.write("room.yaml", format!("outline: {{points_m: [{}]}}\n", corners.join(", ")));
        let said = output(&folder.locsim("validate room-run.yaml").success());
        let (_, secs) = said.split_once("about ").unwrap();
        secs.split_once(" s,").unwrap_or_else(|| panic!("{said}")).0.parse().unwrap()
    };
    let [few, many] = [told(20), told(5000)];
    assert!(many > 3.0 * few, "{few} s, {many} s");
}

/// A map without its image, one that is turned by degrees, and walls of shares beyond all.
#[test]
fn maps_of_other_kinds() {
    let folder = Folder::new();
    let ros = "image: room.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n";
    folder.write("room.yaml", edited(ros, "image: room.pgm\n", ""));
    refused(&folder, "run room-run.yaml", "room.yaml:1: image: the key is missing");
    folder.write("room.pgm", [&b"P5\r\n# drawn\r\n2 2\r\n255\r\n"[..], &[254; 4]].concat());
    folder.write("room.yaml", ros);
    let call = folder.locsim("run room-run.yaml").code(2);
    call.stderr(contains("room.yaml:1: image: map image room.pgm: its header ends in CR LF"));
    folder.write("room.pgm", [&b"P5\n2 2\n255\n"[..], &[254; 4]].concat());
    folder.write("room.yaml", edited(ros, "[0, 0, 0]", "[0, 0, 90]"));
    refused(
        &folder,
        "run room-run.yaml",
        "room.yaml:3: origin: origin must be [x, y, yaw], with the yaw in radians, up to a turn, and all of the map \
         within 10000000 m of 0; got [0.0, 0.0, 90.0]",
    );
    let walls = "seen:\n  - [[0, 0], [3, 0], [3, 2], [0, 2]]\nwalls:\n  - {from_m: [3, 0], to_m: [0, 0], sigma_m: 0.01, hits: 9, hit_share: 0.9}\n";
    for (from, to, message) in [
        (
            "hit_share: 0.9",
            "hit_share: 90",
            "hit_share: `hit_share` of `wall-0`: 90 is not allowed; a share, 0 to 1",
        ),
        (
            "hit_share: 0.9",
            "hit_share: .nan",
            "hit_share: `hit_share` of `wall-0`: NaN is not allowed; a share, 0 to 1",
        ),
        (
            "sigma_m: 0.01",
            "sigma_m: -1",
            "sigma_m: `sigma_m` of `wall-0`: -1 is not allowed; a length of 0 to 10000000 (m)",
        ),
    ] {
        folder.write("room.yaml", edited(walls, from, to));
        refused(&folder, "run room-run.yaml", &format!("room.yaml:4: walls[0].{message}"));
    }
}

/// A ROS map of a room of 3.2 m by 1.8 m in cells of 10 cm, whose image has these two values for wall and floor.
fn ros_map(folder: &Folder, wall: u8, floor: u8, keys: &str) {
    let (width, height) = (36, 22);
    let mut image = format!("P5\n{width} {height}\n255\n").into_bytes();
    for y in 0..height {
        for x in 0..width {
            let inside = (2..width - 2).contains(&x) && (2..height - 2).contains(&y);
            image.push(if inside { floor } else { wall });
        }
    }
    folder.write("floor.pgm", image);
    let thresholds = "occupied_thresh: 0.65\nfree_thresh: 0.25\n";
    let text = format!("image: floor.pgm\nresolution: 0.1\norigin: [-0.2, -0.2, 0]\n{keys}{thresholds}");
    folder.write("floor.yaml", text);
}

#[test]
fn a_map_that_is_read_the_wrong_way_around() {
    let folder = Folder::new();
    folder.write("s.yaml", edited(SCENARIO, "room.yaml", "floor.yaml"));
    folder.locsim("simulate room-run.yaml --out drive.log").success();
    folder.write("log.yaml", edited(ON_A_LOG, "room.yaml", "floor.yaml"));
    for (wall, floor, keys) in
        [(0, 254, "negate: 0\nmode: trinary\n"), (254, 0, "negate: 1\n"), (100, 0, "mode: raw\nnegate: 0\n")]
    {
        ros_map(&folder, wall, floor, keys);
        folder.locsim("validate s.yaml log.yaml").success();
    }
    let others = "positions of the robot would be in free space; with";
    for (wall, floor, keys, blamed, right) in [
        (0, 254, "negate: 1\nmode: trinary\n", "4: negate: 1", "`negate: 0`"),
        (254, 0, "mode: trinary\nnegate: 0\n", "5: negate: 0", "`negate: 1`"),
        (0, 254, "negate: 0\nmode: raw\n", "5: mode: raw", "`mode: trinary`"),
        (100, 0, "negate: 0\nmode: trinary\n", "5: mode: trinary", "`mode: raw`"),
    ] {
        ros_map(&folder, wall, floor, keys);
        let message =
            format!("floor.yaml:{blamed} is not allowed for this image: 0 of the 2 {others} {right} 2 are");
        for command in ["validate s.yaml", "run s.yaml"] {
            refused(&folder, command, &message);
        }
        let start = format!("error: floor.yaml:{blamed} is not allowed for this image: 0 of the ");
        folder.locsim("run log.yaml").code(2).stderr(starts_with(start.as_str())).stderr(contains(right));
        folder.locsim("validate log.yaml").code(2).stderr(contains(start.as_str()));
    }
    // A waypoint inside a wall is the path's mistake.
    ros_map(&folder, 0, 254, "negate: 0\n");
    folder.write(
        "w.yaml",
        edited(SCENARIO, "room.yaml", "floor.yaml")
            .replace("[[0.6, 0.9], [2.6, 0.9]]", "[[0.6, 0.9], [-0.1, 0.9]]"),
    );
    folder.locsim("validate w.yaml").code(2).stderr(contains("robot.path.waypoints.points_m[1]"));
}
