//! glTF files against what the specification says that they mean (*glTF 2.0 Specification*, Khronos
//! Group, 2021).
#![cfg(feature = "gltf")]

use geofan_core::Result;
use geofan_render::{Footprint, scene::Mesh};
use glam::DVec3;
use std::path::Path;

/// A binary file with this JSON and these bytes behind it.
fn glb(json: &str, bytes: &[u8]) -> Vec<u8> {
    let padded = |part: &[u8], with: u8| {
        let mut part = part.to_vec();
        part.resize(part.len().next_multiple_of(4), with);
        part
    };
    let (json, bytes) = (padded(json.as_bytes(), b' '), padded(bytes, 0));
    let mut file = b"glTF\x02\0\0\0".to_vec();
    let whole = 12 + 8 + json.len() + 8 + bytes.len();
    file.extend((whole as u32).to_le_bytes());
    for (kind, part) in [(b"JSON", json), (b"BIN\0", bytes)] {
        file.extend((part.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(part);
    }
    file
}

/// Corners of a square of side 1, its two triangles, texture coordinates (v runs down) and colours as
/// bytes: 48, 12, 32 and 16 bytes.
fn square() -> Vec<u8> {
    let mut bytes = Vec::new();
    let floats =
        |all: &[f32], bytes: &mut Vec<u8>| bytes.extend(all.iter().flat_map(|x| x.to_le_bytes()));
    floats(
        &[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.],
        &mut bytes,
    );
    bytes.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()));
    floats(&[0., 1., 1., 1., 1., 0., 0., 0.], &mut bytes);
    bytes.extend([
        255, 0, 0, 255, 255, 0, 0, 255, 255, 0, 0, 255, 0, 0, 255, 51,
    ]);
    bytes
}

/// The JSON of that square with parts of it replaced.
fn json(nodes: &str, attributes: &str, rest: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":{nodes},
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0{attributes}}},"indices":1,"material":0}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
        {{"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"}},
        {{"bufferView":2,"componentType":5126,"count":4,"type":"VEC2"}},
        {{"bufferView":3,"componentType":5121,"normalized":true,"count":4,"type":"VEC4"}}],
        "bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":12}},
        {{"buffer":0,"byteOffset":60,"byteLength":32}},{{"buffer":0,"byteOffset":92,"byteLength":16}},
        {{"buffer":0,"byteOffset":108,"byteLength":PICTURE}}],{rest}}}"#
    )
}

fn load(bytes: &[u8], folder: &Path) -> Result<Mesh> {
    let path = folder.join("a.glb");
    std::fs::write(&path, bytes).unwrap();
    Mesh::load(&path)
}

/// The square with a picture behind its bytes.
fn loaded(json: &str, picture: &[u8]) -> Result<Mesh> {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = square();
    bytes.extend(picture);
    let json = json.replace("PICTURE", &picture.len().max(1).to_string());
    let json = json.replace("BYTES", &bytes.len().max(109).to_string());
    bytes.resize(bytes.len().max(109), 0);
    load(&glb(&json, &bytes), folder.path())
}

fn near(a: &[f32], b: &[f32]) {
    let same = a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3);
    assert!(same, "{a:?} is not {b:?}");
}

const PLAIN: &str = r#""buffers":[{"byteLength":BYTES}],"materials":[{}]"#;

#[test]
fn nodes_put_meshes_in_their_places_and_mirrors_turn_faces_round() {
    let nodes = r#"[{"children":[1],"translation":[10,0,0]},{"mesh":0,"scale":[-2,1,1]}]"#;
    let mesh = loaded(&json(nodes, "", PLAIN), &[]).unwrap();
    assert_eq!(mesh.positions[2], DVec3::new(8.0, 1.0, 0.0));
    let [a, b, c] = mesh.triangles[0].map(|i| mesh.positions[i as usize]);
    // The square faces +z, and still does in the mirror.
    assert!((b - a).cross(c - a).z > 0.0);
    // Without normals faces are flat.
    assert!(
        mesh.normals.iter().all(|n| *n == DVec3::Z),
        "{:?}",
        mesh.normals
    );
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
}

#[test]
fn opacity_of_vertices_counts_as_the_material_says_and_what_is_left_out_is_told() {
    let nodes = r#"[{"mesh":0}]"#;
    let opacities = |material: &str, extensions: &str| {
        let rest = format!(
            r#""buffers":[{{"byteLength":BYTES}}],"animations":[],"extensionsUsed":[{extensions}],"materials":[{{{material}}}]"#
        );
        let mesh = loaded(&json(nodes, r#","COLOR_0":3"#, &rest), &[]).unwrap();
        let opacities = mesh.colours.iter().map(|colour| colour[3]);
        let least = opacities.fold(1.0_f32, |least, opacity| least.min(opacity));
        (least, mesh.warnings)
    };
    let matt = r#""pbrMetallicRoughness":{"metallicFactor":0}"#;
    let (opaque, said) = opacities(matt, "");
    assert_eq!((opaque, said.len()), (1.0, 0));
    let (blended, _) = opacities(&format!(r#"{matt},"alphaMode":"BLEND""#), "");
    near(&[blended], &[0.2]);
    let (cut, _) = opacities(&format!(r#"{matt},"alphaMode":"MASK""#), "");
    near(&[cut], &[0.0]);
    let (_, said) = opacities("", r#""KHR_materials_clearcoat""#);
    assert!(said[0].ends_with("extensions left out: KHR_materials_clearcoat"));
    assert_eq!(said.len(), 1);
    let partly = r#""pbrMetallicRoughness":{"metallicFactor":0.5}"#;
    let (_, said) = opacities(partly, "");
    assert!(said[0].ends_with(
        "colours of vertices on what is partly metal (its matt part is coloured) left out"
    ));
}

#[test]
fn materials_are_of_metal_and_roughness_with_textures_and_a_cut() {
    let mut picture = Vec::new();
    let pixels = [
        255, 0, 0, 255, 0, 255, 0, 100, 0, 0, 255, 255, 255, 255, 255, 255,
    ];
    let encoder = image::codecs::png::PngEncoder::new(&mut picture);
    image::ImageEncoder::write_image(encoder, &pixels, 2, 2, image::ExtendedColorType::Rgba8)
        .unwrap();
    let rest = r#""buffers":[{"byteLength":BYTES}],
        "images":[{"bufferView":4,"mimeType":"image/png"}],"textures":[{"source":0,"sampler":0}],
        "samplers":[{"wrapS":33648,"wrapT":33071,"magFilter":9728}],"materials":[{"name":"leaf","alphaMode":"MASK","alphaCutoff":0.5,"emissiveFactor":[0,0.5,1],
        "normalTexture":{"index":0},
        "extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":4}},
        "pbrMetallicRoughness":{"baseColorFactor":[0.5,1,1,1],"metallicFactor":0.25,"roughnessFactor":0.5,
        "baseColorTexture":{"index":0}}}]"#;
    let nodes = r#"[{"mesh":0}]"#;
    let mesh = loaded(&json(nodes, r#","TEXCOORD_0":2"#, rest), &picture).unwrap();
    let said = mesh.warnings.as_slice();
    let known = "a.glb: material `leaf`: normal map not drawn";
    assert!(matches!(said, [one] if one.ends_with(known)), "{said:?}");
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    assert_eq!(mesh.uvs[..4], corners);
    let leaf = &mesh.materials[0];
    near(&leaf.kd, &[0.375, 0.75, 0.75]);
    near(&leaf.ke, &[0.0, 2.0, 4.0]);
    // α = 1/4 is as wide as the exponent 30; metal takes the mean of the texture, a half of each.
    near(&[leaf.ns], &[30.0]);
    near(
        &leaf.ks,
        &[0.03 + 0.25 * 0.5 * 0.5, 0.03 + 0.125, 0.03 + 0.125],
    );
    let colour = |u, v| {
        leaf.map_kd
            .as_ref()
            .unwrap()
            .filtered([u, v], &Footprint::POINT)
    };
    near(&colour(0.25, 0.75), &[1.0, 0.0, 0.0]);
    near(&colour(0.25, 0.25), &[0.0, 0.0, 1.0]);
    // Mirrored to the side, the edge's colour upwards, and no blend between pixels.
    near(&colour(1.25, 0.75), &colour(0.75, 0.75));
    near(&colour(0.25, 1.75), &colour(0.25, 0.75));
    near(&colour(0.45, 0.55), &colour(0.25, 0.75));
    let opacity = leaf.map_d.as_ref().unwrap();
    near(
        &[opacity.at([0.25, 0.75]), opacity.at([0.75, 0.75])],
        &[1.0, 0.0],
    );
    assert_eq!(leaf.dissolve, 1.0);
}

#[test]
fn textures_are_turned_and_a_second_set_of_coordinates_is_told() {
    let mut picture = Vec::new();
    let pixels = [255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255];
    let encoder = image::codecs::png::PngEncoder::new(&mut picture);
    image::ImageEncoder::write_image(encoder, &pixels, 2, 2, image::ExtendedColorType::Rgb8)
        .unwrap();
    let rest = r#""buffers":[{"byteLength":BYTES}],"extensionsUsed":["KHR_texture_transform"],
        "images":[{"bufferView":4,"mimeType":"image/png"}],"textures":[{"source":0}],
        "materials":[{"pbrMetallicRoughness":{"metallicFactor":0,"baseColorTexture":{"index":0,
        "extensions":{"KHR_texture_transform":{"rotation":1.5707963267948966,"texCoord":1}}}}}]"#;
    let nodes = r#"[{"mesh":0}]"#;
    let mesh = loaded(&json(nodes, r#","TEXCOORD_0":2"#, rest), &picture).unwrap();
    let said = mesh.warnings.as_slice();
    assert!(
        matches!(said, [one] if one.contains("second set")),
        "{said:?}"
    );
    // Turning the coordinates anticlockwise turns the picture clockwise.
    let map = mesh.materials[0].map_kd.as_ref().unwrap();
    let colour = |u, v| map.filtered([u, v], &Footprint::POINT);
    near(&colour(0.25, 0.75), &[0.0, 0.0, 1.0]);
    near(&colour(0.75, 0.75), &[1.0, 0.0, 0.0]);
    near(&colour(0.75, 0.25), &[0.0, 1.0, 0.0]);
}

#[test]
fn colours_of_vertices_are_linear() {
    let blended = PLAIN.replace("[{}]", r#"[{"alphaMode":"BLEND"}]"#);
    let mesh = loaded(&json(r#"[{"mesh":0}]"#, r#","COLOR_0":3"#, &blended), &[]).unwrap();
    near(&mesh.colours[0], &[1.0, 0.0, 0.0, 1.0]);
    near(&mesh.colours[3], &[0.0, 0.0, 1.0, 0.2]);
}

#[test]
fn texts_with_their_bytes_inside_or_beside_are_read() {
    let bytes = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIA";
    let text = |uri: &str| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
            {{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":6}}],
            "buffers":[{{"byteLength":42,"uri":"{uri}"}}]}}"#
        )
    };
    let folder = tempfile::tempdir().unwrap();
    let inside = text(&format!("data:application/octet-stream;base64,{bytes}"));
    let mesh = load(inside.as_bytes(), folder.path()).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    let beside = text("a%20b.bin");
    let message = load(beside.as_bytes(), folder.path())
        .unwrap_err()
        .to_string();
    assert!(message.contains("a b.bin"), "{message}");
    let floats = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut raw: Vec<u8> = floats.iter().flat_map(|x| x.to_le_bytes()).collect();
    raw.extend([0, 0, 1, 0, 2, 0]);
    std::fs::write(folder.path().join("a b.bin"), raw).unwrap();
    assert_eq!(
        load(beside.as_bytes(), folder.path()).unwrap().triangles,
        [[0, 1, 2]]
    );
}

#[test]
fn what_cannot_be_read_is_named() {
    let told = |json: &str| loaded(json, &[]).unwrap_err().to_string();
    let draco = format!(
        r#"{PLAIN},"extensionsRequired":["KHR_draco_mesh_compression"],"extensionsUsed":["KHR_draco_mesh_compression"]"#
    );
    let message = told(&json(r#"[{"mesh":0}]"#, "", &draco));
    assert!(message.contains("KHR_draco_mesh_compression"), "{message}");
    let circle = r#"[{"children":[1]},{"mesh":0,"children":[0]}]"#;
    let message = told(&json(circle, "", PLAIN));
    assert!(message.contains("no tree"), "{message}");
    let good = json(r#"[{"mesh":0}]"#, "", PLAIN);
    for (from, to, word) in [
        (r#""count":6"#, r#""count":60"#, "ends too early"),
        (
            r#""count":4,"type":"VEC3""#,
            r#""count":3,"type":"VEC3""#,
            "vertex 3",
        ),
        (
            r#""byteLength":48"#,
            r#""byteLength":48000"#,
            "ends too early",
        ),
        (
            r#""componentType":5126,"count":4,"type":"VEC3""#,
            r#""componentType":5126,"count":4,"type":"VEC2""#,
            "three numbers",
        ),
        (r#""bufferView":0,"#, r#""bufferView":9,"#, "a.glb"),
    ] {
        assert!(good.contains(from), "{from}");
        let message = told(&good.replacen(from, to, 1));
        assert!(message.contains(word), "{to}: {message}");
    }
}

#[test]
fn damaged_files_never_panic() {
    let json = json(r#"[{"mesh":0}]"#, r#","COLOR_0":3,"TEXCOORD_0":2"#, PLAIN);
    let json = json.replace("PICTURE", "1").replace("BYTES", "109");
    let mut bytes = square();
    bytes.resize(109, 0);
    let folder = tempfile::tempdir().unwrap();
    for cut in (0..json.len()).step_by(7) {
        for odd in ["9", "-", "\"", "[]", "e30"] {
            let text = format!("{}{odd}{}", &json[..cut], &json[cut..]);
            let _ = load(&glb(&text, &bytes), folder.path());
        }
    }
    let file = glb(&json, &bytes);
    for cut in (0..file.len()).step_by(3) {
        let _ = load(&file[..cut], folder.path());
    }
}
