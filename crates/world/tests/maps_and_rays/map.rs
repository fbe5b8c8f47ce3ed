//! Vector maps and occupancy grids: accepted and refused files, and their geometry.

use std::f64::consts::FRAC_PI_2;
use std::fs;
use std::path::Path;

use glam::DVec2;
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, LumaA, Rgb, RgbImage};
use locsim_core::limits::Limits;
use locsim_core::{Draw, Pose2, Stage};
use locsim_world::map::{
    Cell, ImageFormat, ImageMode, MapError, NamedEdges, OccupancyGrid, OccupancyMapFile, Polyline, VectorMap,
    Wall,
};
use proptest::prelude::*;
use rand::RngExt;

use crate::common;

fn square() -> VectorMap {
    VectorMap {
        outline: Polyline {
            points_m: vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]],
            surfaces: vec![NamedEdges { name: "ends".into(), edges: vec![1, 3] }],
            ..Polyline::default()
        },
        obstacles: vec![Polyline {
            points_m: vec![[1.0, 1.0], [2.0, 1.0], [1.5, 2.0]],
            ..Polyline::default()
        }],
        walls: vec![Wall { name: "screen".into(), from_m: [3.0, 0.0], to_m: [3.0, 1.0] }],
    }
}

#[test]
fn a_vector_map_becomes_named_segments_and_free_space() {
    let geometry = square().to_geometry().unwrap();
    assert_eq!(geometry.segments().len(), 8);
    assert_eq!(geometry.surfaces(), [0, 1, 2, 1, 3, 4, 5, 6]);
    let names = ["outline/0", "ends", "outline/2", "obstacle-0/0", "obstacle-0/1", "obstacle-0/2", "screen"];
    assert_eq!(geometry.surface_names(), names);
    assert_eq!(geometry.bounds(), [0.0, 0.0, 4.0, 4.0]);
    let triangle = 1.0 + 2.0 * 0.5_f64.hypot(1.0);
    assert!((geometry.wall_length_m() - (16.0 + triangle + 1.0)).abs() < 1e-12);
    for (x, y, free) in [(0.5, 0.5, true), (1.5, 1.2, false), (-0.5, 0.5, false), (3.5, 3.9, true)] {
        assert_eq!(geometry.is_free(x, y), free, "({x}, {y})");
    }
    assert!(!geometry.is_free(f64::NAN, 1.0));
}

#[test]
fn overlapping_obstacles_are_not_free_where_they_overlap() {
    let box_at = |x: f64| vec![[x, 1.0], [x + 2.0, 1.0], [x + 2.0, 2.0], [x, 2.0]];
    let outline = vec![[0.0, 0.0], [9.0, 0.0], [9.0, 4.0], [0.0, 4.0]];
    let geometry = common::vector_map(outline, vec![box_at(1.0), box_at(2.0)]);
    assert!(!geometry.is_free(2.5, 1.5));
}

/// Each error names the polyline and the point, edge or name.
#[test]
fn wrong_vector_maps_are_refused_with_their_place() {
    let refused = |change: &dyn Fn(&mut VectorMap)| {
        let mut map = square();
        change(&mut map);
        map.to_geometry().unwrap_err().to_string()
    };
    let named = |name: &str, edges: &[usize]| NamedEdges { name: name.into(), edges: edges.to_vec() };
    assert_eq!(
        refused(&|map| map.outline.points_m[2][1] = f64::NAN),
        "point 2 of `outline` is not finite: [4, NaN]"
    );
    assert_eq!(
        refused(&|map| map.walls[0].to_m[0] = f64::INFINITY),
        "point 1 of `screen` is not finite: [inf, 1]"
    );
    assert_eq!(
        refused(&|map| map.obstacles[0].points_m.truncate(2)),
        "`obstacle-0` has 2 points; a closed polyline needs at least 3"
    );
    assert_eq!(
        refused(&|map| map.outline.points_m.push([0.0, 0.0])),
        "points 4 and 0 of `outline` coincide; edges need a length, and polylines close themselves"
    );
    assert_eq!(
        refused(&|map| map.outline.points_m.swap(1, 2)),
        "edges 0 and 2 of `outline` cross each other; an outline has one inside"
    );
    assert_eq!(
        refused(&|map| {
            let points_m = vec![[0.0, 0.0], [1.0, 1.0], [4.0, 4.0]];
            map.outline = Polyline { points_m, ..Polyline::default() };
        }),
        "`outline` has no area: its points lie on one line"
    );
    assert_eq!(
        refused(&|map| map.walls[0].to_m = [4.0, 10_005.0]),
        "point 1 of `screen` is not allowed: [4, 10005]; at most 10000 m beyond the outline, as no laser reaches farther"
    );
    assert_eq!(
        refused(&|map| map.walls[0].to_m = [3.0, 0.0]),
        "points 0 and 1 of `screen` coincide; edges need a length, and polylines close themselves"
    );
    assert_eq!(
        refused(&|map| map.walls[0].name = "ends".into()),
        "the name `ends` is given twice, the second time in `ends`"
    );
    assert_eq!(
        refused(&|map| map.obstacles[0].surfaces.push(named("ends", &[0]))),
        "the name `ends` is given twice, the second time in `obstacle-0`"
    );
    assert_eq!(
        refused(&|map| map.outline.surfaces.push(named("more", &[4]))),
        "surface `more` names edge 4 of `outline`, which has edges 0 to 3"
    );
    assert_eq!(
        refused(&|map| map.outline.surfaces.push(named("more", &[1]))),
        "edge 1 of `outline` is named twice: `ends` and `more`"
    );
}

/// Two parts of a floor that meet in a point, and a slit between two parts of one edge.
#[test]
fn an_outline_may_touch_itself() {
    for points_m in [
        vec![[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [4.0, 2.0], [4.0, 4.0], [2.0, 4.0], [2.0, 2.0], [0.0, 2.0]],
        vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 4.0], [2.0, 1.0], [2.0, 4.0], [0.0, 4.0]],
    ] {
        let outline = Polyline { points_m, ..square().outline };
        let map =
            VectorMap { outline: Polyline { surfaces: vec![], ..outline }, obstacles: vec![], walls: vec![] };
        assert!(map.to_geometry().unwrap().is_free(1.0, 1.0));
    }
}

fn map_file(image: &str, mode: ImageMode) -> OccupancyMapFile {
    OccupancyMapFile {
        image: image.into(),
        mode,
        resolution: 0.5,
        origin: [0.0, 0.0, 0.0],
        negate: false,
        occupied_thresh: 0.65,
        free_thresh: 0.196,
    }
}

/// Loads one row of grey pixels.
fn row(pixels: &[u8], change: impl Fn(&mut OccupancyMapFile)) -> OccupancyGrid {
    let folder = tempfile::tempdir().unwrap();
    GrayImage::from_raw(pixels.len() as u32, 1, pixels.to_vec())
        .unwrap()
        .save(folder.path().join("map.png"))
        .unwrap();
    let mut file = map_file("map.png", ImageMode::Trinary);
    change(&mut file);
    file.load(folder.path()).unwrap()
}

use Cell::{Free, Occupied, Unknown};

#[test]
fn trinary_pixels_are_free_occupied_or_unknown() {
    let grid = row(&[0, 254, 205, 89, 90], |_| ());
    // 89 is 0.651 dark, 90 is 0.647.
    assert_eq!(grid.cells(), [Occupied, Free, Unknown, Occupied, Unknown]);
    assert_eq!(grid.occupancy(), [1.0, 0.0, 0.5, 1.0, 0.5]);
}

#[test]
fn negated_maps_have_white_walls() {
    assert_eq!(row(&[0, 255, 100], |file| file.negate = true).cells(), [Free, Occupied, Unknown]);
}

#[test]
fn scale_grades_what_lies_between_the_thresholds() {
    let grid = row(&[0, 255, 147], |file| file.mode = ImageMode::Scale);
    assert_eq!(grid.cells(), [Occupied, Free, Unknown]);
    let expected = ((255.0 - 147.0) / 255.0 - 0.196) / (0.65 - 0.196);
    assert!((grid.occupancy()[2] - expected as f32).abs() < 1e-6);
}

#[test]
fn in_scale_mode_transparent_pixels_are_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let image = ImageBuffer::from_fn(2, 1, |x, _| LumaA([0_u8, if x == 0 { 255 } else { 254 }]));
    image.save(folder.path().join("map.png")).unwrap();
    let load = |mode| map_file("map.png", mode).load(folder.path()).unwrap();
    assert_eq!(load(ImageMode::Scale).cells(), [Occupied, Unknown]);
    assert_eq!(load(ImageMode::Trinary).cells(), [Occupied, Occupied]);
}

#[test]
fn raw_pixels_are_percents() {
    let grid = row(&[0, 10, 50, 66, 100, 101, 255], |file| file.mode = ImageMode::Raw);
    assert_eq!(grid.cells(), [Free, Free, Unknown, Occupied, Occupied, Unknown, Unknown]);
    assert_eq!(grid.occupancy(), [0.0, 0.1, 0.5, 0.66, 1.0, 0.5, 0.5]);
}

#[test]
fn the_first_row_of_the_image_is_the_top_of_the_map_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let shade = |x: u32, y: u32| if (x, y) == (0, 0) { 0_u8 } else { 255 };
    GrayImage::from_fn(2, 3, |x, y| Luma([shade(x, y)])).save(path("p5.pgm")).unwrap();
    fs::write(path("p2.pgm"), "P2\n# a comment\n2 3\n255\n0 255\n255 255\n255 255\n").unwrap();
    ImageBuffer::from_fn(2, 3, |x, y| Luma([u16::from(shade(x, y)) * 257])).save(path("deep.png")).unwrap();
    let mut deep = b"P5\n2 3\n65535\n".to_vec();
    deep.extend((0..6).flat_map(|i| u16::to_be_bytes(if i == 0 { 0 } else { u16::MAX })));
    fs::write(path("deep.pgm"), deep).unwrap();
    // Averages 85 (dark enough) and 255.
    RgbImage::from_fn(2, 3, |x, y| if (x, y) == (0, 0) { Rgb([255, 0, 0]) } else { Rgb([255; 3]) })
        .save(path("colour.png"))
        .unwrap();
    for name in ["p5.pgm", "p2.pgm", "deep.png", "deep.pgm", "colour.png"] {
        let grid = map_file(name, ImageMode::Trinary).load(folder.path()).unwrap();
        assert_eq!(grid.cells(), [Free, Free, Free, Free, Occupied, Free], "{name}");
        assert_eq!(grid.cell_at(0.25, 1.25), Some(Occupied), "{name}");
    }
}

#[test]
fn the_origin_shifts_and_turns_the_grid() {
    // Columns run along map y, rows along -x.
    let grid = row(&[255, 255, 0], |file| file.origin = [10.0, -2.0, FRAC_PI_2]);
    assert_eq!(grid.cell_at(9.75, -2.0 + 1.25), Some(Occupied));
    assert_eq!(grid.cell_at(9.75, -2.0 + 0.25), Some(Free));
    assert_eq!(grid.cell_at(10.25, -2.0 + 1.25), None);
    let geometry = grid.to_geometry().unwrap();
    assert!(geometry.is_free(9.75, -1.75) && !geometry.is_free(9.75, -0.75));
    for (got, expected) in geometry.bounds().into_iter().zip([9.5, -2.0, 10.0, -0.5]) {
        assert!((got - expected).abs() < 1e-12);
    }
    for &[a, b] in geometry.segments() {
        for end in [a, b] {
            assert!((9.5..=10.0 + 1e-12).contains(&end.x) && (-1.0 - 1e-12..=-0.5 + 1e-12).contains(&end.y));
        }
    }
}

#[test]
fn wrong_map_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    GrayImage::new(1, 1).save(folder.path().join("map.png")).unwrap();
    fs::write(folder.path().join("damaged.pgm"), "P5\n9 9\n255\nxx").unwrap();
    let load = |change: &dyn Fn(&mut OccupancyMapFile)| {
        let mut file = map_file("map.png", ImageMode::Trinary);
        change(&mut file);
        file.load(folder.path()).unwrap_err()
    };
    assert!(matches!(load(&|file| file.resolution = 0.0), MapError::Resolution(_)));
    assert!(matches!(load(&|file| file.resolution = f64::NAN), MapError::Resolution(_)));
    assert!(matches!(load(&|file| file.origin[2] = f64::INFINITY), MapError::Origin(_)));
    assert!(matches!(load(&|file| file.free_thresh = 0.65), MapError::Thresholds { .. }));
    assert!(matches!(load(&|file| file.occupied_thresh = 1.5), MapError::Thresholds { .. }));
    for name in ["missing.png", "damaged.pgm"] {
        let error = load(&|file| file.image = name.into());
        assert!(matches!(error, MapError::Image { .. }));
        assert!(error.to_string().contains(name));
    }
    assert!(matches!(
        OccupancyGrid::new(2, 2, 1.0, Pose2::IDENTITY, vec![Free; 3], vec![0.0; 3]),
        Err(MapError::GridSize { .. })
    ));
}

#[test]
fn boundaries_of_cells_are_merged_into_walls() {
    // A block of 2 x 2 cells in a grid of 4 x 3: four walls.
    let mut cells = vec![Free; 12];
    for i in [5, 6, 9, 10] {
        cells[i] = Occupied;
    }
    let grid = OccupancyGrid::new(4, 3, 0.5, Pose2::IDENTITY, cells, vec![0.5; 12]).unwrap();
    let geometry = grid.to_geometry().unwrap();
    assert_eq!(geometry.segments().len(), 4);
    assert_eq!(geometry.wall_length_m(), 4.0);
    assert_eq!(geometry.surface_names(), ["wall-0", "wall-1", "wall-2", "wall-3"]);
    assert_eq!(geometry.segments()[0], [DVec2::new(0.5, 0.5), DVec2::new(1.5, 0.5)]);
    assert_eq!(geometry.bounds(), [0.0, 0.0, 2.0, 1.5]);
}

fn random_grid(seed: u64) -> OccupancyGrid {
    let mut rng = Draw::new(seed, Stage::Blocks, 0).item(0);
    let (width, height) = (rng.random_range(1..30), rng.random_range(1..30));
    let (cells, occupancy) = (0..width * height)
        .map(|_| [(Free, 0.0), (Occupied, 1.0), (Unknown, 0.5)][rng.random_range(0..3)])
        .unzip();
    let origin = Pose2::new(rng.random_range(-9.0..9.0), 0.1, rng.random_range(-3.0..3.0));
    OccupancyGrid::new(width, height, 0.05, origin, cells, occupancy).unwrap()
}

proptest! {
    #[test]
    fn a_written_grid_is_read_back_as_it_was(seed in any::<u64>()) {
        let grid = random_grid(seed);
        let folder = tempfile::tempdir().unwrap();
        let image = folder.path().join("map.pgm");
        grid.write_image(&image).unwrap();
        prop_assert!(std::fs::read(image).unwrap().starts_with(b"P5"), "not a binary greymap");
        let file = grid.map_file(Path::new("map.pgm"));
        prop_assert_eq!(&file.load(folder.path()).unwrap(), &grid);
        let text = serde_json::to_string(&file).unwrap();
        prop_assert!(text.starts_with("{\"image\":\"map.pgm\",\"mode\":\"trinary\",\"resolution\":0.05,\"origin\":["), "{text}");
        prop_assert!(text.contains("\"negate\":0,"), "{text}");
    }

    /// Merged boundaries cover each boundary once: their length is that of all sides between occupied and other
    /// cells.
    #[test]
    fn the_length_of_walls_is_the_number_of_boundary_sides(seed in any::<u64>()) {
        let grid = random_grid(seed);
        let (w, h) = (grid.width() as isize, grid.height() as isize);
        let occupied = |x: isize, y: isize| {
            (0..w).contains(&x) && (0..h).contains(&y) && grid.cells()[(y * w + x) as usize] == Occupied
        };
        let sides: usize = (-1..w)
            .flat_map(|x| (-1..h).map(move |y| (x, y)))
            .map(|(x, y)| {
                let here = occupied(x, y);
                usize::from(here != occupied(x + 1, y)) + usize::from(here != occupied(x, y + 1))
            })
            .sum();
        prop_assert!((grid.to_geometry().unwrap().wall_length_m() - 0.05 * sides as f64).abs() < 1e-9);
    }
}

/// Every kind of pixel is read as its 16-bit colour with opacity, which `image` makes of it.
#[test]
fn pixels_of_every_kind_are_read_alike() {
    let folder = tempfile::tempdir().unwrap();
    let mut rng = Draw::new(3, Stage::Blocks, 0).item(0);
    let (width, height) = (37, 23);
    let mut bytes =
        |channels: u32| -> Vec<u8> { (0..width * height * channels).map(|_| rng.random()).collect() };
    let eight = [1, 2, 3, 4].map(&mut bytes);
    let deep = [1, 2, 3, 4].map(|channels| -> Vec<u16> {
        bytes(2 * channels).as_chunks().0.iter().map(|&pair| u16::from_ne_bytes(pair)).collect()
    });
    let [l, la, rgb, rgba] = eight;
    let [l16, la16, rgb16, rgba16] = deep;
    let images = [
        DynamicImage::ImageLuma8(ImageBuffer::from_raw(width, height, l).unwrap()),
        DynamicImage::ImageLumaA8(ImageBuffer::from_raw(width, height, la).unwrap()),
        DynamicImage::ImageRgb8(ImageBuffer::from_raw(width, height, rgb).unwrap()),
        DynamicImage::ImageRgba8(ImageBuffer::from_raw(width, height, rgba).unwrap()),
        DynamicImage::ImageLuma16(ImageBuffer::from_raw(width, height, l16).unwrap()),
        DynamicImage::ImageLumaA16(ImageBuffer::from_raw(width, height, la16).unwrap()),
        DynamicImage::ImageRgb16(ImageBuffer::from_raw(width, height, rgb16).unwrap()),
        DynamicImage::ImageRgba16(ImageBuffer::from_raw(width, height, rgba16).unwrap()),
    ];
    for image in images {
        image.save(folder.path().join("map.png")).unwrap();
        DynamicImage::ImageRgba16(image.to_rgba16()).save(folder.path().join("deep.png")).unwrap();
        for mode in [ImageMode::Trinary, ImageMode::Scale, ImageMode::Raw] {
            let [grid, expected] =
                ["map.png", "deep.png"].map(|name| map_file(name, mode).load(folder.path()).unwrap());
            assert_eq!(grid, expected, "{:?} {mode:?}", image.color());
        }
    }
}

/// A PNG of `width` x `height` pixels of one bit, with this compressed content.
fn png_with_header(width: u32, height: u32, data: &[u8]) -> Vec<u8> {
    let chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut crc = !0_u32;
        for &byte in kind.iter().chain(data) {
            crc ^= u32::from(byte);
            for _ in 0..8 {
                crc = (crc >> 1) ^ (0xedb8_8320 & 0_u32.wrapping_sub(crc & 1));
            }
        }
        [&(data.len() as u32).to_be_bytes(), &kind[..], data, &(!crc).to_be_bytes()].concat()
    };
    let header = [&width.to_be_bytes()[..], &height.to_be_bytes(), &[1, 0, 0, 0, 0]].concat();
    [&b"\x89PNG\r\n\x1a\n"[..], &chunk(b"IHDR", &header), &chunk(b"IDAT", data), &chunk(b"IEND", &[])]
        .concat()
}

#[test]
fn an_image_is_refused_by_its_header() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |bytes: &[u8]| {
        fs::write(folder.path().join("map"), bytes).unwrap();
        map_file("map", ImageMode::Trinary).load(folder.path()).unwrap_err().to_string()
    };
    let most = Limits::current().map_pixels;
    for bytes in [
        png_with_header(20_000, 20_000, &[0x78, 0x9c]),
        b"P5 20000 20000 255\n".to_vec(),
        b"P2 20000 20000 1 0 0".to_vec(),
        b"P4 20000 20000\n".to_vec(),
        b"P6 20000 20000 65535\n".to_vec(),
        b"P7\nWIDTH 20000\nHEIGHT 20000\nDEPTH 1\nMAXVAL 1\nTUPLTYPE BLACKANDWHITE\nENDHDR\n".to_vec(),
    ] {
        let error = refusal(&bytes);
        assert!(
            error.contains(&format!("400000000 pixels of a map's image are not allowed; at most {most}")),
            "{error}"
        );
    }
    // Below the limit, and yet nothing behind the header.
    for bytes in ["P5 8000 8000 255\n", "P5 8000 8000 65535\n", "P6 8000 8000 1\n", "P2 8000 8000 1 0 0"] {
        let error = refusal(bytes.as_bytes());
        assert!(error.contains("it ends before its last pixel"), "{error}");
    }
    for (bytes, what) in [
        ("P5 0 8 255\n", "cannot be made from 0 cells"),
        ("P5 2 2 0\n1234", "MAXVAL"),
        ("P5 2 2 99999999999\n1234", "Overflow"),
        ("P5 4294967295 4294967295 255\n", ""),
        ("P9", ""),
    ] {
        let error = refusal(bytes.as_bytes());
        assert!(error.contains(what) && !error.is_empty(), "{error}");
    }
    let error = map_file(".", ImageMode::Trinary).load(folder.path()).unwrap_err().to_string();
    assert!(error.ends_with("it is no file"), "{error}");
}

#[test]
fn an_image_as_small_as_its_pixels_allow_is_read() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("map"), [&b"P4 8000 100\n"[..], &vec![0xf0; 100_000]].concat()).unwrap();
    let grid = map_file("map", ImageMode::Trinary).load(folder.path()).unwrap();
    assert_eq!((grid.width(), grid.height()), (8000, 100));
    assert_eq!(grid.cells()[..8], [Occupied, Occupied, Occupied, Occupied, Free, Free, Free, Free]);
}

#[test]
fn more_walls_than_allowed_are_counted_and_refused() {
    let side = 800;
    let cells = (0..side * side).map(|i| if (i / side + i) % 2 == 0 { Free } else { Occupied }).collect();
    let grid = OccupancyGrid::new(side, side, 0.05, Pose2::IDENTITY, cells, vec![0.5; side * side]).unwrap();
    let error = grid.to_geometry().unwrap_err().to_string();
    assert!(error.starts_with("1280000 wall segments of a map are not allowed; at most 500000"), "{error}");
    let mut map = square();
    map.walls = vec![map.walls[0].clone(); 1_000_000];
    let error = map.to_geometry().unwrap_err().to_string();
    assert!(error.starts_with("1000007 wall segments of a map are not allowed"), "{error}");
    map.walls.clear();
    map.outline.points_m = vec![[0.0, 0.0]; 20_000];
    let error = map.to_geometry().unwrap_err().to_string();
    assert!(error.starts_with("20003 corners of a vector map's outline and obstacles"), "{error}");
}

#[test]
fn maps_beyond_any_building_are_refused() {
    let load = |change: &dyn Fn(&mut OccupancyMapFile)| {
        let folder = tempfile::tempdir().unwrap();
        GrayImage::new(2, 2).save(folder.path().join("map.png")).unwrap();
        let mut file = map_file("map.png", ImageMode::Trinary);
        change(&mut file);
        file.load(folder.path()).map(drop)
    };
    load(&|file| file.origin = [-9e6, 9e6, 1.0]).unwrap();
    for origin in [[1e300, 0.0, 0.0], [0.0, -1.1e7, 0.0], [f64::MAX, f64::MAX, f64::MAX]] {
        assert!(matches!(load(&|file| file.origin = origin), Err(MapError::Origin(_))));
    }
    for resolution in [1e-300, 9e-5, 1e300, 1e7] {
        assert!(matches!(load(&|file| file.resolution = resolution), Err(MapError::Resolution(_))));
    }
    for far in [1e300, -1.1e7] {
        let mut map = square();
        map.outline.points_m[1] = [far, 0.0];
        let error = map.to_geometry().unwrap_err();
        assert!(matches!(error, MapError::TooFar { point: 1, .. }));
        assert!(
            error.to_string().ends_with("coordinates are metres, at most 10000000 either way"),
            "{error}"
        );
    }
    let mut map = square();
    map.outline.points_m[1] = [1e-300, 0.0];
    assert!(matches!(map.to_geometry(), Err(MapError::ZeroLengthEdge { point: 0, .. })));
}

#[test]
fn a_grid_is_written_as_the_bytes_it_gives() {
    let grid = random_grid(5);
    let folder = tempfile::tempdir().unwrap();
    for (name, format) in [("map.pgm", ImageFormat::Pgm), ("map.png", ImageFormat::Png)] {
        let path = folder.path().join(name);
        grid.write_image(&path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), grid.image_bytes(format));
        assert_eq!(grid.map_file(Path::new(name)).load(folder.path()).unwrap(), grid);
    }
    assert!(grid.write_image(&folder.path().join("map.gif")).is_err());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

/// Images with some bytes changed, cut short or doubled.
fn survive(cases: u32, seed: u64) -> usize {
    let folder = tempfile::tempdir().unwrap();
    let grid = random_grid(7);
    let encode = |image: &DynamicImage, name: &str| {
        image.save(folder.path().join(name)).unwrap();
        fs::read(folder.path().join(name)).unwrap()
    };
    let colour = DynamicImage::ImageRgba16(ImageBuffer::from_fn(5, 7, |x, y| {
        image::Rgba([x as u16 * 9000, y as u16, 7, 9])
    }));
    let seeds = [
        grid.image_bytes(ImageFormat::Pgm),
        grid.image_bytes(ImageFormat::Png),
        encode(&colour, "colour.png"),
        encode(&DynamicImage::ImageRgb8(colour.to_rgb8()), "colour.ppm"),
        encode(&colour, "colour.pam"),
        png_with_header(16, 2, &[0x78, 0x01, 0x01, 6, 0, 0xf9, 0xff, 0, 1, 2, 0, 3, 4, 0, 0x15, 0, 11]),
        b"P2\n# a comment\n2 3\n255\n0 255\n255 255\n255 255\n".to_vec(),
        b"P1\n4 2\n0 1 0 1\n1 1 0 0\n".to_vec(),
        b"P4\n9 2\n\xf0\x80\x0f\x00".to_vec(),
    ];
    let draw = Draw::new(seed, Stage::Blocks, 1);
    let mut accepted = 0;
    for case in 0..cases {
        let mut rng = draw.item(case);
        let mut bytes = seeds[case as usize % seeds.len()].clone();
        for _ in 0..rng.random_range(1..5) {
            if bytes.is_empty() {
                break;
            }
            let i = rng.random_range(0..bytes.len());
            match rng.random_range(0..6) {
                0 => bytes[i] = rng.random(),
                1 => bytes[i] ^= 1 << rng.random_range(0..8),
                2 => bytes[i] = b"0129 \n#P\xff\x00"[rng.random_range(0..10)],
                3 => bytes.truncate(i),
                4 => bytes.insert(i, rng.random()),
                _ => {
                    let part = bytes[i..].to_vec();
                    bytes.extend(part);
                }
            }
        }
        fs::write(folder.path().join("map"), &bytes).unwrap();
        let mode = [ImageMode::Trinary, ImageMode::Scale, ImageMode::Raw][case as usize % 3];
        if let Ok(grid) = map_file("map", mode).load(folder.path()) {
            accepted += 1;
            assert_eq!(grid.cells().len(), grid.width() * grid.height());
            if grid.cells().len() < 1 << 16 {
                grid.to_geometry().unwrap();
            }
        }
    }
    accepted
}

#[test]
fn no_image_brings_the_reader_down() {
    let accepted = survive(3000, 1);
    assert!((300..2700).contains(&accepted), "{accepted} were read");
}
