use super::*;
use crate::scene::{Mapping, Material, OpacityMap, Texture, TextureMap, Wrap};
use ndarray::{Array2, Array3};
use std::{path::Path, sync::Arc};

/// A lattice of squares over a wave, in decimals as files have them.
fn wave(decimals: usize) -> Mesh {
    let decimal = |x: f64| format!("{x:.decimals$}").parse::<f64>().unwrap();
    let mut mesh = Mesh::default();
    for i in 0..12 {
        for j in 0..10 {
            let (x, y) = (f64::from(i) * 0.1, f64::from(j) * 0.07);
            let place = [x, y, (3.0 * x).sin() * y].map(decimal);
            let normal = DVec3::new(-3.0 * (3.0 * x).cos() * y, -(3.0 * x).sin(), 1.0);
            let normal = normal.normalize().to_array().map(decimal);
            mesh.positions.push(DVec3::from_array(place));
            mesh.normals.push(unit_or_none(DVec3::from_array(normal)));
            mesh.uvs.push([x as f32, decimal(y) as f32]);
        }
    }
    for i in 0..11 {
        for j in 0..9 {
            let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(k, l)| (i + k) * 10 + j + l);
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
            mesh.material_of.extend([0, (i + j) % 2]);
        }
    }
    mesh.materials = vec![Material::default(), textured()];
    mesh
}

fn textured() -> Material {
    let mapping = Mapping {
        scale: [2.0, 3.0],
        cross: [0.5, -0.25],
        wrap: [Wrap::Clamp, Wrap::Mirror],
        nearest: true,
        ..Mapping::default()
    };
    let pixels = Array3::from_shape_fn((4, 5, 3), |(y, x, c)| (x + y * c) as f32 / 20.0);
    let values = Array2::from_shape_fn((3, 2), |(y, x)| (x + y) as f32 / 255.0);
    Material {
        name: "wood".into(),
        illumination: 3,
        map_kd: Some(TextureMap {
            texture: Arc::new(Texture::new(pixels).unwrap()),
            mapping,
        }),
        map_d: Some(OpacityMap {
            values: Arc::new(values),
            mapping: Mapping::default(),
        }),
        ..Material::default()
    }
}

fn back(mesh: &Mesh) -> Mesh {
    let bytes = pack(&[(30.0, mesh)]);
    read("a.obj", bytes.strip_prefix(MAGIC).unwrap(), 30.0).unwrap()
}

#[test]
fn what_was_written_in_decimals_comes_back_exactly() {
    let mesh = wave(4);
    let found = back(&mesh);
    assert_eq!(found.positions, mesh.positions);
    assert_eq!(found.normals, mesh.normals);
    assert_eq!(found.uvs, mesh.uvs);
    assert_eq!(found.triangles, mesh.triangles);
    assert_eq!(found.material_of, mesh.material_of);
    assert_eq!(found.materials.len(), 2);
    assert_eq!(
        format!("{:?}", found.materials[0]),
        format!("{:?}", mesh.materials[0])
    );
    let [a, b] = [&found.materials[1], &mesh.materials[1]];
    assert_eq!(format!("{:?}", a.map_d), format!("{:?}", b.map_d));
    assert_eq!(
        a.map_kd.as_ref().unwrap().mapping,
        b.map_kd.as_ref().unwrap().mapping
    );
    assert_eq!((a.name.as_str(), a.illumination), ("wood", 3));
}

#[test]
fn computed_normals_are_turned_by_less_than_is_stated() {
    let mesh = wave(17);
    let found = back(&mesh);
    assert_eq!(found.positions, mesh.positions);
    for (a, b) in found.normals.iter().zip(&mesh.normals) {
        assert!(a.angle_between(*b) < 1e-7 && (a.length() - 1.0).abs() < 1e-15);
    }
}

#[test]
fn every_mesh_of_the_gallery_comes_back_exactly() {
    for name in ["teapot", "torus-knot", "globe", "pawn", "letter-F"] {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/meshes");
        let path = Path::new(folder).join(format!("{name}.obj"));
        let mesh = Mesh::load(&path).unwrap();
        let found = back(&mesh);
        assert!(
            found.positions == mesh.positions && found.normals == mesh.normals,
            "{name}"
        );
        assert!(
            found.triangles == mesh.triangles && found.uvs == mesh.uvs,
            "{name}"
        );
    }
}

#[test]
fn meshes_are_found_by_their_crease_and_damaged_ones_are_refused() {
    let (mesh, mut other) = (wave(3), wave(3));
    other.triangles.truncate(4);
    other.material_of.truncate(4);
    let bytes = pack(&[(30.0, &mesh), (10.0, &other)]);
    let bytes = bytes.strip_prefix(MAGIC).unwrap();
    assert_eq!(read("a", bytes, 10.0).unwrap().triangles.len(), 4);
    assert!(
        read("a", bytes, 20.0)
            .unwrap_err()
            .to_string()
            .contains("crease 20")
    );
    for length in 1..bytes.len() {
        assert!(read("a", &bytes[..length], 10.0).is_err(), "{length}");
    }
    // Whatever the bytes are, there is an answer.
    for i in 0..bytes.len().min(4000) {
        let mut damaged = bytes.to_vec();
        damaged[i] ^= 0x55;
        let _ = read("a", &damaged, 30.0);
    }
}
