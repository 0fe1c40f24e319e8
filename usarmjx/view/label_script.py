"""Script of the live page that keeps texts from covering each other."""

LABEL_SCRIPT = """
(() => {
 const GAP = 2, STEADY = 6, LIFTS = 3;  // pixels, pixels, and places of a text: its own and those above
 const PIXELS = 40;  // of the library's unit of texts of constant size
 const lifted = new Map();
 // The library draws a rectangle behind each text; these meshes have all of them.
 const boards = scene => {
  const found = [];
  scene.traverse(one => {
   const uniforms = one.material?.uniforms;
   if (uniforms?.uLabelData && !uniforms.uAtlas && one.geometry.attributes.aRect) found.push(one);
  });
  return found;
 };
 const texts = (meshes, places, view, scale) => {
  const found = [];
  for (const {geometry} of meshes) {
   const {aLabelIndex, aRect, aParams} = geometry.attributes;
   for (let i = 0; i < aLabelIndex.count; i++) {
    const id = aLabelIndex.array[i], at = 4 * id, [x, y, z, shown] = places.slice(at, at + 4);
    const depth = -(view[2] * x + view[6] * y + view[10] * z + view[14]);
    if (!shown || !aParams.array[2 * i] || depth <= 0) continue;
    const [left, low, width, tall] = aRect.array.slice(4 * i, 4 * i + 4).map(
     one => one * aParams.array[2 * i + 1] * PIXELS);
    found.push({
     id, at, depth, width, tall,
     left: (view[0] * x + view[4] * y + view[8] * z + view[12]) / depth * scale + left,
     low: (view[1] * x + view[5] * y + view[9] * z + view[13]) / depth * scale + low,
    });
   }
  }
  return found.sort((a, b) => Math.abs(a.tall - b.tall) > .01 ? b.tall - a.tall : a.depth - b.depth);
 };
 const arrange = (scene, camera) => {
  const meshes = boards(scene);
  if (!meshes.length) return;
  const {uLabelData, uViewportHeight} = meshes[0].material.uniforms, places = uLabelData.value.image.data;
  const view = camera.matrixWorldInverse.elements;
  const scale = camera.projectionMatrix.elements[5] * uViewportHeight.value / 2, kept = [];
  for (const one of texts(meshes, places, view, scale)) {
   const before = lifted.get(one.id) ?? 0;
   const fits = lift => {
    const gap = lift < before ? STEADY : GAP, low = one.low + lift * (one.tall + GAP);
    return !kept.some(other =>
     one.left < other.left + other.width + gap && other.left < one.left + one.width + gap &&
     low < other.low + other.tall + gap && other.low < low + one.tall + gap);
   };
   let lift = 0;
   while (lift < LIFTS && !fits(lift)) lift++;
   lifted.set(one.id, lift);
   if (lift === LIFTS) { places[one.at + 3] = 0; continue; }
   const up = lift * (one.tall + GAP) * one.depth / scale;
   for (let axis = 0; axis < 3; axis++) places[one.at + axis] += up * view[4 * axis + 1];
   one.low += lift * (one.tall + GAP);
   kept.push(one);
  }
  uLabelData.value.needsUpdate = true;
 };
 const wait = setInterval(() => {
  const scene = window.__viserMutable?.scene;
  if (!scene) return;
  clearInterval(wait);
  scene.onBeforeRender = (renderer, same, camera) => arrange(same, camera);
 }, 100);
})();
"""
"""Before each picture, a text that would cover another one moves up by a line or two, or is hidden.

Larger texts keep their places before smaller ones, near ones before distant ones. A version of the library
with other names shows all texts where they are.
"""
