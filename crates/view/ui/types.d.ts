// Types of the messages of PROTOCOL.md, for the type checker alone; nothing of this is shipped.

export type Kind = "table" | "exact" | "flat" | "error";
export type Sky = "scene" | "grid" | "stars";
export type Triple = [number, number, number];

/** From the user interface. */
export type ViewerEvent =
  | { type: "resize"; width: number; height: number }
  | { type: "hold"; go: number[]; turn: number[]; roll: number; fast: boolean }
  | { type: "look"; right: number; down: number }
  | { type: "speed" | "zoom"; factor: number }
  | { type: "home" | "follow" | "halt" }
  | { type: "view"; name: string }
  | { type: "place"; at: number[]; look: number[]; up: number[]; fov: number }
  | { type: "show"; kind: Kind; split: Kind | null }
  | { type: "exposure"; stops: number }
  | { type: "sky"; sky: Sky }
  | { type: "beyond"; allowed: boolean }
  | { type: "still"; samples: number }
  | { type: "paths"; passes: number }
  | { type: "resolution"; share: number }
  | { type: "hover" | "pick"; x: number; y: number }
  | { type: "record"; on: boolean }
  | { type: "replay"; text: string }
  | { type: "capture"; width: number; height: number; samples: number; light: boolean }
  | { type: "parameter"; name: string; value: number }
  | { type: "shown"; frame: number };

export interface Quantiles { p50: number; p95: number; p99: number; max: number }

/** `PanelData` in panel.rs. */
export interface Panel {
  manifold: string;
  coordinates: [string, string, string];
  parameters: [string, number][];
  chosen: string[];
  views: string[];
  pose: { at: Triple; look: Triple; up: Triple; fov: number };
  curvature: number | null;
  kind: Kind;
  split: Kind | null;
  promise: number | null;
  no_table?: string | null;
  certificate: string | null;
  sky: Sky;
  beyond: boolean;
  within_table: boolean;
  decoding: boolean;
  speed: number;
  moving_share: number;
  exposure: number;
  size: [number, number];
  samples: number;
  passes: [number, number];
  settled: boolean;
  display: [number, number];
  seconds: number | null;
  rate: number | null;
  hint: string | null;
  trouble: string | null;
  background: string | null;
  errors: [Quantiles, number] | null;
  legend: [number | null, Triple][];
  hover: [string, number] | null;
  picked: { points: Triple[]; jumps: number[]; length: number; end: string; object: boolean } | null;
  recording: number | null;
  recorded: boolean;
  travelling: boolean;
}

/** Settings in the page's address; those of the manifold's parameters besides. */
export interface Settings {
  at?: number[];
  look?: number[];
  up?: number[];
  fov?: number;
  show?: Kind;
  split?: Kind | null;
  sky?: Sky;
  exposure?: number;
  moving?: number;
  still?: number;
  paths?: number;
  beyond?: boolean;
  speed?: number;
  /** The numbers over the picture are shown. */
  overlay?: boolean;
  /** Columns and rows of the picture to save, if they are not the display's. */
  "save.width"?: number;
  "save.height"?: number;
  "save.samples"?: number;
  "save.format"?: "png" | "exr";
  /** Workers of a page, which it reads itself when it begins. */
  workers?: number;
}

/** From the engine, besides pixels. */
export type Message =
  | { type: "panel"; panel: Panel }
  | { type: "recorded"; text: string }
  | { type: "broken"; text: string };

export interface ViewEngine {
  send(event: ViewerEvent): void;
  onpatch(buffer: ArrayBuffer): void;
  onmessage(message: Message): void;
  onopen(): void;
  /** `why`: in words. */
  onlost(why: string): void;
}

export type Send = (event: ViewerEvent) => void;
export type Say = (words: string) => void;
export type Save = (kind: "png" | "exr", blob: Blob) => void;
